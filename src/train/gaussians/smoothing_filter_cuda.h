// CUDA version of SmoothingFilter::compute(), without torch.
#pragma once

#include <cuda_runtime_api.h>

#include "train/gaussians/smoothing_filter_args.h"

namespace b3dgs::cuda {

/// Asynchronous.
void compute_filters(const SmoothingFilterArgs& args, cudaStream_t stream);

}  // namespace b3dgs::cuda
