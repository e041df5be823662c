// One optimizer step: views are rendered and compared with their photographs, and the Gaussians move along the mean
// gradient.
//
// A step takes --batch views, by default one. An iteration stays one view, so that schedules keep their meaning: a step
// takes the iterations up to the next multiple of --batch. Work that falls on one of them and is not part of a step
// (density control, evaluation, files) comes after the step.
//
// A step that fails can be taken again (recovery.h), because it changes Gaussians, moments and statistics last, and
// nothing can fail after the first of these changes: by then the photographs are loaded and all memory is allocated.
// A step that keeps the gradients of its views adds statistics before that, so the caller saves them. Deferred
// optimizer updates need no roll-back, because they may be applied at any time (optimizer/deferred_sh.h).
//
// take_step() is for a process that has all Gaussians. Several processes share the other functions
// (multi/rank_step.cpp).
#pragma once

#include <cstdint>
#include <functional>
#include <vector>

#include "core/check.h"
#include "train/checkpoint/train_state.h"
#include "train/training.h"

namespace b3dgs {

/// The loss is not finite, or no valid Gaussian is left: the model may be damaged, and no checkpoint is written.
using LossError = ErrorOf<struct LossKind, NumericError>;

struct StepView {
  std::int32_t index = 0;  // in Scene::train
  int iteration = 0;
  bool is_empty = false;  // no Gaussian is visible
};

/// The end of the last step. The next one starts from it, and returns to it if it fails.
struct LastStep {
  StepPosition position;
  std::int64_t adam_steps = 0;
  std::vector<StepView> unread_losses;  // views whose losses a GPU may still be computing
};

struct StepOutcome {
  std::vector<StepView> views;          // all of the step
  std::vector<ViewSize> sizes;          // of the views that this process has rendered, see measure_view()
  std::vector<StepView> unread_losses;  // views whose losses are still to be read
};

/// Takes one step. Reads the losses of the step before when the device has finished them. @throws what failed, with the
/// state to be rolled back unless Adam has begun; LossError
StepOutcome take_step(Training& training, LastStep& before);

// The parts of a step.

/// Begins a step up to iteration `last`.
void begin_step(Training& training, int last);
RenderSettings step_settings(Training& training, int iteration);
/// Ends the kernel check that is under way, unless the view of `next_iteration` belongs to it and will come.
void decide_kernel(Training& training, int next_iteration);
/// Calls render(), and adds iteration and view to errors of its arithmetic.
RenderedView render_view(const TrainView& view, int iteration, const std::function<RenderedView()>& render);
/// Returns the size of the view rendered last, with the pairs that it would have if it were not reduced
/// (--coarse_scale). If the rasterizer's buffers have changed, returns memory that the allocator caches.
ViewSize measure_view(Training& training, int iteration);
/// Returns the gradient of the loss, see Objective::compare().
RenderedViewGrad loss_gradient(Training& training, const TrainView& view, int iteration, const RenderedView& rendered,
                               bool wants_errors);
/// Weights by the average loss before the step, which all processes know.
RegularizationWeights regularization(const Training& training, const LastStep& before);
/// Takes the Adam step along the gradients that were kept, and the steps of appearance and poses.
/// `model_rows`: see DensityStrategy::after_step().
void finish_step(Training& training, const std::vector<StepView>& views, const torch::Tensor& model_rows = {});

/// Whether steps keep the gradients of their views' splats, from which a pass of its own takes the Adam step. Else
/// the backward pass of the one view does that, which is faster. The GPU compiler may fuse multiplications and
/// additions differently in the two; --deterministic always has the bytes of the former.
bool keeps_gradients(const Training& training);

/// Waits for these losses and adds them to the average. @throws LossError
void read_losses(Training& training, LastStep& before, std::vector<StepView>& unread);
/// Adds the loss of a view to the average. @throws LossError if it is not finite
void add_loss(Training& training, LastStep& before, const StepView& view, double value);

}  // namespace b3dgs
