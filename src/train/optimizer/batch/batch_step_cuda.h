// CUDA version of an optimizer step over several views, without torch.
#pragma once

#include "raster/cuda/device_buffer.h"
#include "train/optimizer/adam_args.h"
#include "train/optimizer/batch/batch_grad.h"
#include "train/optimizer/deferred_sh.h"

namespace b3dgs::cuda {

/// Gradients of the mean over the views, and an Adam step along them.
struct BatchStepArgs {
  BatchGradArgs grad{};
  AdamGroups adam{};  // arrays of grad.gaussians; gradients are not used
  AdamRule rule{};
  std::int32_t n_deferred = 0;        // steps deferred before this one
  DeferredUpdate* updates = nullptr;  // [N] written for Gaussians that any view sees
};
static_assert(sizeof(BatchStepArgs) <= 4096, "a kernel's arguments");

/// SH coefficients beyond degree 0 are stepped too, for Gaussians that any view sees: their deferred updates must have
/// been applied, which the views' forward passes do. For the others, this step is to be deferred. Arrays are aligned to
/// 16 bytes. Asynchronous.
void step_batch(const BatchStepArgs& args, const LaunchContext& context);

}  // namespace b3dgs::cuda
