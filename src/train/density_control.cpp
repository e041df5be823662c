#include "train/density_control.h"

#include <algorithm>
#include <vector>

#include "core/text.h"

namespace b3dgs {

void DensityControl::run() {
  TrainState& state = training_.state;
  for (; state.n_density_pending > 0; --state.n_density_pending) run(state.iteration - state.n_density_pending + 1);
}

void DensityControl::run(int iteration) {
  TrainState& state = training_.state;
  const DensityPlan plan = training_.density->plan(iteration);
  if (plan.densify) {
    training_.recorder.report_progress("densifying");
    training_.timer.start(StageTimes::Kind::kDensityRound);
    stepper_.flush();
    run_round(iteration);
    training_.timer.finish();
    if (state.n_gaussians() == 0) {
      training_.is_consistent = false;
      throw NumericError(detail::concat("iteration ", state.iteration, ": density control removed the last Gaussian; ",
                                        "lower the learning rates"));
    }
  }
  if (plan.lower_opacities) training_.density->lower_opacities(state.gaussians, state.adam);
}

void DensityControl::run_round(int iteration) {
  stepper_.begin_round();
  const std::vector<MemoryRemedy> remedies{stepper_.together(training_.wait_for_files()),
                                           stepper_.together(training_.free_scratch())};
  try {
    with_remedies(remedies, [&] { plan_and_apply(iteration); });
  } catch (const OutOfMemoryError&) {
    growth_has_failed_ = true;
    hold_count(training_.state.n_gaussians());
    // Once more without growth: pruning still takes place.
    try {
      with_remedies(remedies, [&] { plan_and_apply(iteration); });
    } catch (const OutOfMemoryError&) {
      // The Gaussians may be as many in all, and still more in one of several processes. Once more without new ones.
      with_remedies(remedies, [&] { plan_and_apply(iteration, /*adds=*/false); });
    }
  }
  stepper_.end_round();
  training_.trim_memory();
}

void DensityControl::plan_and_apply(int iteration, bool adds) {
  TrainState& state = training_.state;
  const std::int64_t before = state.n_gaussians();
  const std::int64_t room = stepper_.room_for_gaussians().value_or(0);
  if (state.held_at > 0 && can_grow_again(room)) state.held_at = 0;
  const std::int64_t allowed = smaller_limit(training_.config.max_gaussians, state.held_at);
  const std::int64_t limit = adds ? smaller_limit(allowed, room) : 1;
  const DensityRound round = stepper_.plan_round(iteration, limit);
  if (adds && round.n_over_limit > 0 && limit != allowed) hold_count(std::max(room, before));
  stepper_.apply_round(round, iteration, limit);
}

bool DensityControl::can_grow_again(std::int64_t room) const {
  // With less room, the count would be held again in every round.
  constexpr double kWorthwhile = 1.05;
  // A deterministic training must not depend on how much memory is free.
  if (training_.config.deterministic || growth_has_failed_) return false;
  return room == 0 || static_cast<double>(room) > kWorthwhile * static_cast<double>(training_.state.held_at);
}

void DensityControl::hold_count(std::int64_t count) {
  TrainState& state = training_.state;
  constexpr double kNoteworthy = 0.99;  // of the count logged before
  const bool is_news =
      state.held_at == 0 || static_cast<double>(count) < kNoteworthy * static_cast<double>(state.held_at);
  state.held_at = count;
  if (!is_news) return;
  training_.recorder.say("held at " + format_count(count) + " Gaussians: GPU memory");
  training_.recorder.log_event(state.iteration, "held",
                               {{"reason", "GPU memory"},
                                {"count", count},
                                {"in_use_bytes", training_.memory->use().in_use},
                                {"limit_bytes", training_.memory->limit().value_or(0)}});
}

}  // namespace b3dgs
