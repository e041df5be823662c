// CUDA version of the depth loss, without torch.
#pragma once

#include <cuda_runtime_api.h>

#include "train/depth/depth_loss_args.h"

namespace b3dgs::cuda {

/// Asynchronous.
void depth_loss_gradient(const DepthLossArgs& args, cudaStream_t stream);

}  // namespace b3dgs::cuda
