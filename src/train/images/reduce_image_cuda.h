// CUDA version of the area filter, without torch.
#pragma once

#include <cuda_runtime_api.h>

#include "train/images/reduce_image.h"

namespace b3dgs::cuda {

/// Writes all reduced pixels. Asynchronous.
void reduce_image(const ReduceImageArgs& args, cudaStream_t stream);

}  // namespace b3dgs::cuda
