// CUDA version of SmoothingFilter::compute(), without torch.
#pragma once

#include <cuda_runtime_api.h>

#include "train/gaussians/smoothing_filter_args.h"

namespace b3dgs::cuda {

/// The two halves: pixel sizes and the largest of them, then filters. Asynchronous.
void find_finest_pixels(const SmoothingFilterArgs& args, cudaStream_t stream);
void size_filters(const SmoothingFilterArgs& args, cudaStream_t stream);

}  // namespace b3dgs::cuda
