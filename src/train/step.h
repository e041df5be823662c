// One optimizer step renders some views, compares them with their photographs, and moves the Gaussians along the mean
// gradient.
//
// A step takes --batch views, by default one. An iteration is still one view, so that schedules keep their meaning. A
// step therefore covers the iterations up to the next multiple of --batch. Work that is due in one of them but is not
// part of a step (density control, evaluation, files) follows after the step.
//
// A step that fails can be taken again (step_runner.h), because Gaussians, moments and statistics change last, after
// the photographs are loaded and all memory is allocated. A step that keeps the gradients of its views adds to the
// statistics earlier, so the caller saves them. Deferred optimizer updates need no roll-back, because they may be
// applied at any time (optimizer/deferred_sh.h).
//
// take_step() is for a process that has all Gaussians. Trainings on several processes use the other functions
// (multi/rank_step.cpp).
#pragma once

#include <cstdint>
#include <functional>
#include <vector>

#include "core/check.h"
#include "train/checkpoint/train_state.h"
#include "train/training.h"

namespace b3dgs {

/// The loss is not finite, or no valid Gaussian is left. The model may be damaged, so no checkpoint is written.
using LossError = ErrorOf<struct LossKind, NumericError>;

/// A view of a step.
struct StepView {
  std::int32_t index = 0;  // in Scene::train
  int iteration = 0;
  bool is_empty = false;  // no Gaussian is visible
};

/// State at the end of the last step, from which the next one starts and to which it is rolled back if it fails.
struct LastStep {
  StepPosition position;
  std::int64_t adam_steps = 0;
  std::vector<StepView> unread_losses;  // views whose losses the GPU may still be computing
};

/// Results of one step.
struct StepOutcome {
  std::vector<StepView> views;          // all views of the step
  std::vector<ViewSize> sizes;          // full_size_of_view() of the views that this process rendered
  std::vector<StepView> unread_losses;  // views whose losses have not been read yet
};

/// Takes one step. Reads the losses of the previous step once the device has finished them. @throws any error of the
/// step; the caller must roll the state back unless Adam has begun. @throws LossError
StepOutcome take_step(Training& training, LastStep& before);

// The parts of a step.

/// Starts timing if the step is timed, raises the SH degree and updates the 3D filters. `last_iteration` is the last
/// one of the step.
void begin_step(Training& training, int last_iteration);
/// Returns the settings for rendering the training view of an iteration.
RenderSettings step_settings(Training& training, int iteration);
/// Completes the current kernel check and logs its decision, unless the view of `iteration` still belongs to the check.
/// Beyond the last iteration, completes it in any case.
void decide_kernel(Training& training, int iteration);
/// Calls render(). Adds iteration and view to the message of a NumericError other than InvalidGaussianError.
RenderedView name_view_in_errors(const TrainView& view, int iteration, const std::function<RenderedView()>& render);
/// Returns the size of the view rendered last. With --coarse_scale, n_pairs is the most that it would have at full
/// size.
ViewSize full_size_of_view(const Training& training, int iteration);
/// Returns excess cached memory to the device if the last view has changed the size of the rasterizer's buffers.
void trim_after_view(Training& training);
/// Returns the gradient of the loss, see Objective::gradient().
RenderedViewGrad loss_gradient(Training& training, const TrainView& view, int iteration, const RenderedView& rendered,
                               bool wants_errors);
/// Returns the weights of the regularisation, which depend on the average loss before the step, because all processes
/// know that.
RegularizationWeights regularization(const Training& training, const LastStep& before);
/// Takes the Adam step if gradients were kept, and the steps of appearance and poses, calls
/// DensityStrategy::after_step(), which explains `model_rows`, and ends timing.
void finish_step(Training& training, const std::vector<StepView>& views, const torch::Tensor& model_rows = {});

/// Returns whether steps keep the gradients of their views' splats, so that a separate pass takes the Adam step.
/// Otherwise the backward pass of the only view takes it, which is faster. The GPU compiler may fuse multiplications
/// and additions differently in the two, so --deterministic on a GPU always uses the separate pass.
bool keeps_gradients(const Training& training);

/// Waits for these losses and adds them to the running average. @throws LossError
void read_losses(Training& training, LastStep& before, std::vector<StepView>& unread);
/// Adds the loss of a view to the running average. @throws LossError if it is not finite
void add_loss(Training& training, LastStep& before, const StepView& view, double value);

}  // namespace b3dgs
