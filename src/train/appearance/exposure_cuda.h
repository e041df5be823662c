// CUDA version of the exposure model, without torch. Everything is asynchronous.
#pragma once

#include <cuda_runtime_api.h>

#include "train/appearance/exposure_args.h"

namespace b3dgs::cuda {

void apply_exposure(const ExposureArgs& args, cudaStream_t stream);

/// Sums have a fixed order.
void exposure_backward(const ExposureArgs& args, cudaStream_t stream);

void exposure_step(const ExposureStepArgs& args, cudaStream_t stream);

}  // namespace b3dgs::cuda
