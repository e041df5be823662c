// CUDA version of an optimizer step, without torch.
#pragma once

#include "train/optimizer/deferred_sh.h"
#include "train/optimizer/regularization.h"

namespace b3dgs::cuda {

/// The projection's backward pass and an Adam step along its gradients; updates of SH coefficients beyond degree 0 are
/// deferred.
struct GaussianStepArgs {
  ProjectBackwardCudaArgs backward{};  // of `grad` only means2d is written: [N, 2], for the projected centre
  AdamGroups adam{};                   // arrays of backward.gaussians, without the last group; gradients are not used
  DeferredUpdate* updates = nullptr;   // [N] written for Gaussians that the view sees
  std::int32_t n_deferred = 0;         // steps deferred before this one
  RegularizationGrad regularization{};
};

/// One kernel for both: a Gaussian's gradient stays in registers and is never stored. Arrays are aligned to 16 bytes.
/// Asynchronous.
void step_gaussians(const GaussianStepArgs& args, const LaunchContext& context);

}  // namespace b3dgs::cuda
