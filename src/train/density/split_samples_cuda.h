// CUDA version of the split samples, without torch.
#pragma once

#include <cuda_runtime_api.h>

#include "train/density/split_samples.h"

namespace b3dgs::cuda {

/// Draws all samples. Asynchronous.
void draw_split_samples(const SplitSampleArgs& args, cudaStream_t stream);

}  // namespace b3dgs::cuda
