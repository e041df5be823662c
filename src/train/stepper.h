// Takes the optimizer steps of a training: views are rendered and compared with their photographs, and the Gaussians
// move along the mean gradient.
//
// A step takes --batch views, by default one. An iteration stays one view, so that schedules keep their meaning: a step
// takes the iterations up to the next multiple of --batch. What falls on one of them and is not part of a step (density
// control, evaluation, files) comes after the step.
//
// If a step fails, the state is rolled back to the end of the step before; for lack of memory, it is taken again while
// some can be freed. That is cheap because a step changes Gaussians, moments and statistics last, and nothing can fail
// after the first of these changes: by then the photographs are loaded and all memory is allocated. Statistics that are
// added view by view are saved before. Deferred optimizer updates need no roll-back: they may be applied at any time
// (optimizer/deferred_sh.h).
//
// In this class all Gaussians are in this process. A training on several overrides what differs there
// (multi/rank_stepper.h); the rest of a training does not know which it is.
#pragma once

#include <cstdint>
#include <functional>
#include <optional>
#include <string>
#include <vector>

#include <nlohmann/json.hpp>

#include "core/check.h"
#include "raster/checks.h"
#include "train/density/row_edit.h"
#include "train/gaussians/smoothing_filter.h"
#include "train/memory/memory.h"
#include "train/optimizer/gaussian_optimizer.h"
#include "train/training.h"

namespace b3dgs {

/// The loss is not finite, or no valid Gaussian is left: the model may be damaged, and no checkpoint is written.
using LossError = ErrorOf<struct LossKind, NumericError>;

class Stepper {
 public:
  /// `training` must outlive this.
  explicit Stepper(Training& training);
  virtual ~Stepper() = default;

  // Steps.

  /// Takes one step, and repeats it without Gaussians that cannot be rendered, or with more free memory. @throws what
  /// failed, with the state rolled back; LossError
  void step();
  /// Waits for the losses not yet read, adds them to the average, and moves the poses. @throws LossError
  virtual void complete_pending();
  /// Does the density control that falls on the iterations of the last step and has not been done yet: rounds within
  /// the available memory. If a round, or the views after it, would not fit, the number of Gaussians is held and
  /// training continues with the existing ones.
  void run_density_control();
  /// Ends the kernel check that is under way, unless the view of `next_iteration` belongs to it and will come.
  void decide_kernel(int next_iteration);
  /// Warns if no Gaussian is visible in half of the training views, or in more than before.
  void warn_of_empty_views();

  // The model.

  /// Where the state is to be when adopt_model() is called: no GPU has room for all of a model of several processes.
  torch::Device load_device() const { return is_alone() ? training_.device : torch::Device(torch::kCPU); }
  /// Once the state has Gaussians: at the start, or from a checkpoint.
  virtual void adopt_model() {}
  /// Makes the appearance state, unless that of a checkpoint fits; drops it if no option asks for it.
  void prepare_appearance();
  /// Applies the deferred optimizer updates, which is part of training.
  void flush() {
    if (state_.gaussians.size() > 0) optimizer_.flush(state_.gaussians, state_.adam);
  }
  /// The state without deferred updates, and with filters for anti-aliasing.
  TrainState& flushed_state() {
    flush();
    update_filters(/*is_due=*/false);
    return state_;
  }
  /// Renders the model. Of several processes, within on_first(). @throws InvalidGaussianError
  virtual RenderedView render(const CameraView& view, const RenderSettings& settings) {
    return training_.rasterizer.forward(flushed_state().gaussians, view, settings);
  }
  /// Repeats `work` without the Gaussians that it cannot render.
  template <class Work>
  auto without_invalid_gaussians(Work&& work) {
    for (;;) {
      try {
        return work();
      } catch (const InvalidGaussianError& error) {
        remove_invalid_gaussians(error);
      }
    }
  }
  /// All Gaussians; undefined where writes_files() is false.
  virtual GaussianTensors whole_gaussians() { return flushed_state().gaussians; }
  virtual void write_checkpoint(const nlohmann::ordered_json& scene_fingerprint);

  GaussianMemory memory_of_gaussian();
  /// Of the largest view, whatever is in it: its pixels in the rasterizer, and images beyond those of the last steps.
  std::int64_t memory_of_images();

  // What several processes agree on, or one of them does for all.

  virtual bool is_alone() const { return true; }
  virtual bool writes_files() const { return true; }
  /// @throws InputError if the processes have read different scenes
  virtual void check_same_scene(const nlohmann::ordered_json& /*fingerprint*/) {}
  /// What is missing in the model folder at the start of a session.
  struct Missing {
    bool ply = false, checkpoint = false;
  };
  virtual Missing agree_on_start(Missing here) { return here; }
  /// Whether training is to end after this step.
  virtual bool must_stop() const { return training_.is_stopped(); }
  virtual bool is_checkpoint_due() const { return training_.recorder.is_checkpoint_due(); }
  /// Calls work() where files are written; it may render the whole model.
  virtual void on_first(const std::function<void()>& work) {
    complete_pending();
    work();
  }
  /// Whether all files of the last iteration could be written.
  virtual bool has_written_files() { return training_.recorder.failed_files().empty(); }
  /// "; last checkpoint: PATH", to be appended to an error.
  virtual std::string last_checkpoint() const { return training_.recorder.last_checkpoint(); }
  /// After a failure: whether all processes are in a state in which they can write a checkpoint.
  virtual bool can_save() const { return true; }

 protected:
  struct ViewOfStep {
    std::int32_t index = 0;  // in Scene::train
    int iteration = 0;
  };

  virtual void take_step();
  /// Begins a step up to iteration `last`. All processes call it together.
  void begin_step(int last);
  /// Renders the view of the current iteration and compares it with its photograph. Keeps the gradients of its splats,
  /// or takes the step along them, see keeps_gradients().
  void learn_view(const TrainView& view);
  /// Takes the step along the gradients that were kept, and what belongs to it.
  /// `model_rows`: see DensityStrategy::after_step().
  void finish_step(const torch::Tensor& model_rows = {});

  /// Whether steps keep the gradients of their views' splats, from which a pass of its own takes the Adam step. Else
  /// the backward pass of the one view does that, which is faster. The GPU compiler may fuse multiplications and
  /// additions differently in the two; --deterministic always has the bytes of the former.
  bool keeps_gradients() const {
    return !is_alone() || config_.batch > 1 || (config_.deterministic && !training_.device.is_cpu());
  }
  /// Of the step, by the loss before it, which all processes know.
  RegularizationWeights regularization() const;
  RenderSettings step_settings(int iteration);
  /// With --antialiasing, computes the filters of the Gaussians if that is due or rows have changed. All processes call
  /// it together.
  void update_filters(bool is_due);
  virtual void compute_filters(SmoothingFilter& filter) { filter.compute(state_.gaussians); }
  /// The gradient of the loss, see Objective::compare().
  RenderedViewGrad compare(const TrainView& view, int iteration, const RenderedView& rendered, bool wants_errors);
  /// Memory is planned with the sizes of the views that were rendered.
  void note_view_size(int iteration);
  /// Warns after each view has been rendered once if no Gaussian is visible in some of them.
  void note_visibility(std::int32_t view, bool is_empty);

  // Rounds of density control.

  /// Number of Gaussians for which there is memory; nothing if memory is not limited.
  virtual std::optional<std::int64_t> room_for_gaussians();
  virtual void begin_round() { state_.view_ratios.begin_round(); }
  virtual DensityRound plan_round(int iteration, std::int64_t limit) {
    return training_.density->plan_round(state_.gaussians, state_.statistics, iteration, limit);
  }
  /// `limit`: of the model's Gaussians; 0 = none.
  virtual void apply_round(const DensityRound& round, int iteration, std::int64_t limit) {
    reserve_rows(round.edit, limit);
    apply_reserved(round.edit, iteration);
  }
  /// A remedy that counts as successful in all processes if it is in one.
  virtual MemoryRemedy together(MemoryRemedy remedy) { return remedy; }
  /// Memory for an edit of this process' rows, if possible with spare capacity, so that most rounds reallocate nothing.
  /// `limit`: of the rows; 0 = none.
  void reserve_rows(const RowEdit& edit, std::int64_t limit);
  void apply_reserved(const RowEdit& edit, int iteration);

  // Failures.

  /// Adds the loss of a view to the average. @throws LossError if it is not finite
  void add_loss(const ViewOfStep& view, double value);
  /// Keeps a copy of the statistics for roll_back(), before the first view of a step is added to them.
  void save_statistics();
  void roll_back();
  void remove_invalid_gaussians(const InvalidGaussianError& error);
  /// Removes the Gaussian of this row of the model, and others that are invalid. Returns their number.
  virtual std::int64_t remove_invalid_rows(std::int64_t row);

  Training& training_;
  TrainState& state_;  // training_.state
  const TrainConfig& config_;
  GaussianOptimizer optimizer_;
  CameraView largest_view_{};
  std::optional<SmoothingFilter> smoothing_filter_;  // with --antialiasing
  RowEditor row_editor_;
  std::vector<ViewOfStep> learned_views_, unread_losses_;  // of the last step
  /// Of the last step, for roll_back().
  struct Before {
    StepPosition position;
    std::int64_t adam_steps = 0;
  } before_;

 private:
  ViewMemory memory_of_view();
  // density_control.cpp
  /// With fewer or no new Gaussians if memory is short.
  void run_round(int iteration);
  void plan_and_apply(int iteration, bool adds);
  /// Whether the hold can end now that there is memory for `room` Gaussians (0 = any number).
  bool can_grow_again(std::int64_t room) const;
  /// The model does not grow beyond `count` until there is memory for more. Logged at the start of a hold and when it
  /// drops by over 1 %.
  void hold_count(std::int64_t count);

  std::vector<torch::Tensor> saved_statistics_;  // as they were before the step; empty = not changed
  std::vector<bool> empty_views_;                // no Gaussian was visible when the view was rendered last
  std::size_t n_rendered_ = 0, n_empty_at_warning_ = 0;
  std::int64_t view_bytes_ = 0;  // of the rasterizer's buffers after the last view
  std::int64_t n_removed_at_warning_ = 0;
  bool growth_has_failed_ = false;  // in this session, although memory had seemed sufficient
};

}  // namespace b3dgs
