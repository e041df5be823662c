#include "train/step_runner.h"

#include <optional>
#include <string>
#include <utility>

#include "config/batch_steps.h"
#include "core/text.h"
#include "train/memory/memory.h"

namespace b3dgs {

void StepRunner::run_step() {
  TrainState& state = training_.state;
  std::vector<MemoryRemedy> remedies = training_.remedies();
  std::optional<StepOutcome> outcome;
  while (!outcome) {
    last_.position = state;
    last_.adam_steps = state.adam.steps;
    try {
      save_statistics();
      // With several processes, one that repeated a joint step alone would leave the others waiting. Each repeats its
      // own parts of the step instead.
      if (!state.is_whole()) remedies.clear();
      outcome = team_.take_step(last_);
    } catch (const LossError&) {
      throw;
    } catch (const InvalidGaussianError& error) {
      roll_back();
      remove_invalid_gaussians(error);
    } catch (...) {
      roll_back();
      if (!training_.is_consistent) throw;  // the Gaussians have changed
      free_memory_or_rethrow(remedies);
    }
  }
  saved_statistics_.clear();
  last_.unread_losses = outcome->unread_losses;
  state.n_density_pending = state.step_iterations;
  note_views(*outcome);
}

void StepRunner::read_losses() {
  training_.views.poses.take_queued_steps();
  team_.read_losses(last_);
}

void StepRunner::note_views(const StepOutcome& outcome) {
  TrainState& state = training_.state;
  if (training_.memory->limit()) {
    for (const ViewSize& size : outcome.sizes) {
      state.view_ratios.add(size.n_splats, size.n_pairs, state.gaussians.size());
    }
  }
  for (const StepView& view : outcome.views) {
    if (training_.empty_views.add(view.index, view.is_empty)) warn_of_empty_views(view.iteration);
  }
}

void StepRunner::warn_of_empty_views(int iteration) {
  const std::string warning = training_.empty_views.take_warning();
  if (warning.empty()) return;
  team_.on_first([&] {
    training_.recorder.warn(detail::concat("after iteration ", iteration, ": ", warning,
                                           "; check their poses, --near_plane (", training_.config.near_plane,
                                           ") and the learning rates"));
  });
}

void StepRunner::save_statistics() {
  if (!keeps_gradients(training_)) return;
  const int from = training_.state.iteration;
  bool adds = false;
  for (int i = from + 1; i <= step_end(training_.config.batch, training_.config.iterations, from); ++i) {
    adds |= training_.density->plan(i).statistics;
  }
  if (!adds) return;
  std::vector<torch::Tensor> saved;
  for (const torch::Tensor* column : training_.state.statistics.all()) saved.push_back(column->clone());
  saved_statistics_ = std::move(saved);
}

void StepRunner::roll_back() {
  training_.timer.cancel();
  TrainState& state = training_.state;
  if (state.adam.steps != last_.adam_steps) {  // Adam has begun, so Gaussians may have changed
    training_.is_consistent = false;
    return;
  }
  training_.optimizer.drop_views();
  training_.views.poses.drop_gradients();
  for (std::size_t i = 0; i < saved_statistics_.size(); ++i) state.statistics.all()[i]->copy_(saved_statistics_[i]);
  saved_statistics_.clear();
  static_cast<StepPosition&>(state) = last_.position;
}

void StepRunner::remove_invalid_gaussians(const InvalidGaussianError& error) {
  TrainState& state = training_.state;
  read_losses();  // throws if a loss is not finite, which would be the cause
  training_.flush();
  training_.is_consistent = false;
  const std::int64_t n = team_.remove_invalid_rows(error.row());
  training_.is_consistent = true;
  state.n_removed += n;
  const std::string reason = first_line(error.what());
  training_.recorder.log_event(state.iteration, "gaussians_removed",
                               {{"count", n}, {"total", state.n_removed}, {"reason", reason}});
  if (state.n_gaussians() == 0) {
    throw LossError(detail::concat("after iteration ", state.iteration, ": no Gaussian is left that can be rendered: ",
                                   reason, training_.last_checkpoint()));
  }
  if (state.n_removed < 2 * n_removed_at_warning_) return;
  n_removed_at_warning_ = state.n_removed;
  training_.recorder.warn(detail::concat("after iteration ", state.iteration, ": removed ", n,
                                         n == 1 ? " Gaussian" : " Gaussians", " that cannot be rendered (",
                                         state.n_removed, " so far): ", reason));
}

}  // namespace b3dgs
