// The processes that train one model together. Team itself is a process that trains alone. RankTeam (multi/rank_team.h)
// overrides it for several processes, each of which owns part of the Gaussians. Elsewhere, only TrainState::is_whole(),
// Training::whole_device and Training::find_largest_filter depend on there being several.
#pragma once

#include <cstdint>
#include <functional>
#include <string>

#include "train/density/density_strategy.h"
#include "train/evaluate.h"
#include "train/step.h"
#include "train/training.h"

namespace b3dgs {

/// Requests after a step. Any process can stop the training. The first process decides about checkpoints.
struct StepRequests {
  bool stop = false, write_checkpoint = false;
};

/// All processes must call the same functions in the same order.
class Team {
 public:
  /// `training` must outlive this object.
  explicit Team(Training& training, bool is_first = true)
      : training_(training), state_(training.state), config_(training.config), is_first_(is_first) {}
  virtual ~Team() = default;

  /// Calls work() in the first process only, which is the one that writes files.
  template <class Work>
  void on_first(Work&& work) const {
    if (is_first_) work();
  }
  /// Returns the value of the first process.
  bool ask_first(const std::string& label, bool here) { return max(label, is_first_ && here ? 1 : 0) != 0; }
  /// Returns whether all processes can still write a checkpoint after a failure.
  bool can_save() const { return can_save_; }

  /// Returns the largest value of all processes. `label` names the exchange, for error messages.
  virtual std::int64_t max(const std::string& /*label*/, std::int64_t value) { return value; }
  /// Returns the requests for the time after the current step.
  virtual StepRequests requests() const { return {training_.is_stopped(), training_.recorder.is_checkpoint_due()}; }

  // The step.
  virtual StepOutcome take_step(LastStep& before) { return b3dgs::take_step(training_, before); }
  /// Waits for the losses of the last step, and adds them to the running average. @throws LossError
  virtual void read_losses(LastStep& last) { b3dgs::read_losses(training_, last, last.unread_losses); }

  // The model.
  /// Gives each process its part of the model. Called when Training::state contains the whole model, on
  /// Training::whole_device.
  virtual void distribute_model() {}
  /// Calls work() in the first process, while the other processes render their parts for it.
  virtual void render_on_first(const std::function<void(const RenderModelFn&)>& work);
  /// Returns all Gaussians in the first process, and undefined tensors in the others.
  virtual GaussianTensors gather_gaussians() { return training_.flushed_state().gaussians; }
  /// Writes a checkpoint of the whole model.
  virtual void write_checkpoint();
  /// Removes the Gaussian with this index in the whole model and others that are invalid. Returns the number removed.
  virtual std::int64_t remove_invalid_rows(std::int64_t row);

  /// Plans and applies a round of density control. `limit` is the maximum number of Gaussians of the whole model, 0 for
  /// no limit. on_planned() is called before anything changes.
  virtual void run_round(int iteration, std::int64_t limit, const std::function<void(const DensityRound&)>& on_planned);

 protected:
  Training& training_;
  TrainState& state_;          // training_.state
  const TrainConfig& config_;  // training_.config
  const bool is_first_;
  bool can_save_ = true;
};

}  // namespace b3dgs
