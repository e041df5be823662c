// The door to gaussian_step.cu.
#pragma once

#include "raster/cuda/passes.h"
#include "train/adam_args.h"

namespace b3dgs::cuda {

/// The projection's backward pass and an Adam step along its gradients.
struct GaussianStepArgs {
  ProjectBackwardCudaArgs backward{};  // of `grad` only means2d is written: [N, 2] gradient by the splat's centre
  AdamGroups adam{};                   // the arrays of backward.gaussians; their gradients are not used
};

/// One kernel for both: a Gaussian's gradient goes from registers and shared memory into the step, and is nowhere
/// stored. Arrays are aligned to 16 bytes. Does not wait.
void step_gaussians(const GaussianStepArgs& args, const LaunchContext& context);

}  // namespace b3dgs::cuda
