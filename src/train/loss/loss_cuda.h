// CUDA version of the loss, without torch.
#pragma once

#include <cuda_runtime_api.h>

#include "train/loss/loss_args.h"

namespace b3dgs::cuda {

/// Floats of workspace for an image; aligned to 8 bytes.
std::int64_t loss_workspace_size(std::int32_t width, std::int32_t height);

/// Writes the loss to `value` (device memory) and the gradient; sums have a fixed order. Asynchronous.
void compute_loss(const LossArgs& args, LossValue* value, cudaStream_t stream);

/// Asynchronous.
void compute_error_image(const ErrorImageArgs& args, cudaStream_t stream);

}  // namespace b3dgs::cuda
