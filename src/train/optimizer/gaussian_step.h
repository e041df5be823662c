// The backward projection and the optimizer step on the GPU, without torch.
#pragma once

#include "raster/cuda/passes.h"
#include "train/optimizer/adam_args.h"
#include "train/optimizer/batch_grad.h"
#include "train/optimizer/deferred_sh.h"
#include "train/optimizer/sh_decay.h"

namespace b3dgs::cuda {

struct GaussianStepArgs {
  ProjectBackwardCudaArgs backward{};  // in `grad`, only means2d [N, 2] is written
  AdamGroups adam{};                   // arrays of backward.gaussians; gradients and the last group are not used
  DeferredUpdate* updates = nullptr;   // [N] written for visible Gaussians
  std::int32_t n_deferred = 0;         // steps deferred before this one
  RegularizationGrad regularization{};
  ShDecayArgs sh_decay{};
};

/// Runs the backward projection and an Adam step along its gradients in one kernel. Updates of SH coefficients beyond
/// degree 0 are deferred. Arrays are aligned to 16 bytes. Asynchronous.
void step_gaussians(const GaussianStepArgs& args, const LaunchContext& context);

struct BatchStepArgs {
  BatchGradArgs grad{};
  AdamGroups adam{};  // arrays of grad.gaussians; gradients are not used
  AdamRule rule{};
  std::int32_t n_deferred = 0;        // steps deferred before this one
  DeferredUpdate* updates = nullptr;  // [N] written for Gaussians that are visible in any view
  ShDecayArgs sh_decay{};
};
static_assert(sizeof(BatchStepArgs) <= 4096, "a kernel's arguments");

/// Computes the gradients of the mean over the views and takes an Adam step along them. This includes the SH
/// coefficients beyond degree 0 of Gaussians that are visible in any view, because the forward passes have applied
/// their deferred updates. The caller defers this step for the other Gaussians. Arrays are aligned to 16 bytes.
/// Asynchronous.
void step_batch(const BatchStepArgs& args, const LaunchContext& context);

}  // namespace b3dgs::cuda
