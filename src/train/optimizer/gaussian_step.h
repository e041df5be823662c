// The projection's backward pass and the optimizer step on the GPU, without torch.
#pragma once

#include "raster/cuda/passes.h"
#include "train/optimizer/adam_args.h"
#include "train/optimizer/batch_grad.h"
#include "train/optimizer/deferred_sh.h"

namespace b3dgs::cuda {

struct GaussianStepArgs {
  ProjectBackwardCudaArgs backward{};  // of `grad` only means2d is written: [N, 2], for the projected centre
  AdamGroups adam{};                   // arrays of backward.gaussians, without the last group; gradients are not used
  DeferredUpdate* updates = nullptr;   // [N] written for Gaussians that the view sees
  std::int32_t n_deferred = 0;         // steps deferred before this one
  RegularizationGrad regularization{};
};

/// The projection's backward pass and an Adam step along its gradients in one kernel; updates of SH coefficients beyond
/// degree 0 are deferred. Arrays are aligned to 16 bytes. Asynchronous.
void step_gaussians(const GaussianStepArgs& args, const LaunchContext& context);

struct BatchStepArgs {
  BatchGradArgs grad{};
  AdamGroups adam{};  // arrays of grad.gaussians; gradients are not used
  AdamRule rule{};
  std::int32_t n_deferred = 0;        // steps deferred before this one
  DeferredUpdate* updates = nullptr;  // [N] written for Gaussians that any view sees
};
static_assert(sizeof(BatchStepArgs) <= 4096, "a kernel's arguments");

/// Gradients of the mean over the views, and an Adam step along them. SH coefficients beyond degree 0 are stepped too,
/// for Gaussians that any view sees, whose deferred updates the forward passes have applied; the caller defers this
/// step for the others. Arrays are aligned to 16 bytes. Asynchronous.
void step_batch(const BatchStepArgs& args, const LaunchContext& context);

}  // namespace b3dgs::cuda
