// The door to gaussian_step.cu.
#pragma once

#include "train/optimizer/deferred_sh.h"

namespace b3dgs::cuda {

/// The projection's backward pass and an Adam step along its gradients; what harmonics beyond degree 0 owe from it.
struct GaussianStepArgs {
  ProjectBackwardCudaArgs backward{};  // of `grad` only means2d is written: [N, 2] gradient by the splat's centre
  AdamGroups adam{};           // the arrays of backward.gaussians, but for the last group; gradients are not used
  OwedSteps* owed = nullptr;   // [N] written where the view sees the Gaussian
  std::int32_t n_put_off = 0;  // steps before this one
};

/// One kernel for both: a Gaussian's gradient goes from registers into the step, and is nowhere stored. Arrays are
/// aligned to 16 bytes. Does not wait.
void step_gaussians(const GaussianStepArgs& args, const LaunchContext& context);

}  // namespace b3dgs::cuda
