// The processes that train one model together. A Team is a process that trains alone; multi/rank_team.h derives that of
// several, each of which holds some of the Gaussians. The rest of a training asks no more about them than this.
#pragma once

#include <cstdint>
#include <functional>
#include <string>

#include "train/density/density_strategy.h"
#include "train/evaluate.h"
#include "train/step.h"
#include "train/training.h"

namespace b3dgs {

/// Requests after a step. Any process can stop the training; the first one decides about checkpoints.
struct StepRequests {
  bool stop = false, write_checkpoint = false;
};

/// All processes call the same functions in one order.
class Team {
 public:
  /// `training` must outlive this.
  explicit Team(Training& training, bool is_first = true)
      : training_(training), state_(training.state), config_(training.config), is_first_(is_first) {}
  virtual ~Team() = default;

  /// Calls work() in the first process, which writes the files.
  template <class Work>
  void on_first(Work&& work) const {
    if (is_first_) work();
  }
  /// Returns the first process' value.
  bool ask_first(const std::string& label, bool here) { return max(label, is_first_ && here ? 1 : 0) != 0; }
  /// Whether, after a failure, all processes are in a state in which they can write a checkpoint.
  bool can_save() const { return can_save_; }

  /// Returns the largest of all processes' values. `label` says what is exchanged.
  virtual std::int64_t max(const std::string& /*label*/, std::int64_t value) { return value; }
  virtual StepRequests requests() const { return {training_.is_stopped(), training_.recorder.is_checkpoint_due()}; }

  // The step.
  virtual StepOutcome take_step(LastStep& before) { return b3dgs::take_step(training_, before); }
  /// Waits for the losses of the last step, and adds them to the average. @throws LossError
  virtual void read_losses(LastStep& last) { b3dgs::read_losses(training_, last, last.unread_losses); }

  // The model.
  /// Called once Training::state has the whole model, on Training::whole_device.
  virtual void distribute_model() {}
  /// Calls work() in the first process, while the others help it to render.
  virtual void render_on_first(const std::function<void(const RenderModelFn&)>& work);
  /// Returns all Gaussians; undefined tensors in all processes but the first.
  virtual GaussianTensors gather_gaussians() { return training_.flushed_state().gaussians; }
  virtual void write_checkpoint();
  /// Removes the Gaussian of this row of the model, and others that are invalid. Returns their number.
  virtual std::int64_t remove_invalid_rows(std::int64_t row);

  /// Plans and applies a round of density control. `limit`: of the model's Gaussians; 0 = none. on_planned() is called
  /// before anything has changed.
  virtual void run_round(int iteration, std::int64_t limit, const std::function<void(const DensityRound&)>& on_planned);

 protected:
  Training& training_;
  TrainState& state_;  // these are of training_
  const TrainConfig& config_;
  const bool is_first_;
  bool can_save_ = true;
};

}  // namespace b3dgs
