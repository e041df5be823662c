// Stepper's rounds of density control within the available memory.
#include <algorithm>
#include <utility>
#include <vector>

#include "core/text.h"
#include "train/stepper.h"

namespace b3dgs {
namespace {

/// The smaller of two limits on the number of Gaussians; 0 = no limit.
std::int64_t smaller_limit(std::int64_t a, std::int64_t b) {
  return a == 0 || b == 0 ? std::max(a, b) : std::min(a, b);
}

}  // namespace

void Stepper::run_density_control() {
  for (; state_.n_density_pending > 0; --state_.n_density_pending) {
    const int iteration = state_.iteration - state_.n_density_pending + 1;
    const DensityPlan plan = training_.density->plan(iteration);
    if (plan.densify) {
      training_.recorder.report_progress("densifying");
      training_.timer.start(StageTimes::Kind::kDensityRound);
      flush();
      run_round(iteration);
      training_.timer.finish();
      if (state_.n_gaussians() == 0) {
        training_.is_consistent = false;
        throw NumericError(detail::concat("iteration ", state_.iteration,
                                          ": density control removed the last Gaussian; lower the learning rates"));
      }
    }
    if (plan.lower_opacities) training_.density->lower_opacities(state_.gaussians, state_.adam);
  }
}

void Stepper::run_round(int iteration) {
  begin_round();
  const std::vector<MemoryRemedy> remedies{together(training_.wait_for_files()), together(training_.free_scratch())};
  // The second try prunes but does not grow the model. Its total may be unchanged, yet one of several processes may
  // hold more: the third try adds none.
  for (int n_failures = 0;; ++n_failures) {
    try {
      with_remedies(remedies, [&] { plan_and_apply(iteration, /*adds=*/n_failures < 2); });
      break;
    } catch (const OutOfMemoryError&) {
      if (n_failures == 2) throw;
      growth_has_failed_ = true;
      if (n_failures == 0) hold_count(state_.n_gaussians());
    }
  }
  training_.trim_memory();
}

void Stepper::plan_and_apply(int iteration, bool adds) {
  const std::int64_t before = state_.n_gaussians();
  const std::int64_t room = room_for_gaussians().value_or(0);
  if (state_.held_at > 0 && can_grow_again(room)) state_.held_at = 0;
  const std::int64_t allowed = smaller_limit(config_.max_gaussians, state_.held_at);
  const std::int64_t limit = adds ? smaller_limit(allowed, room) : 1;
  const DensityRound round = plan_round(iteration, limit);
  if (adds && round.n_over_limit > 0 && limit != allowed) hold_count(std::max(room, before));
  apply_round(round, iteration, limit);
}

bool Stepper::can_grow_again(std::int64_t room) const {
  // With less room, the count would be held again in every round.
  constexpr double kWorthwhile = 1.05;
  // A deterministic training must not depend on how much memory is free.
  if (config_.deterministic || growth_has_failed_) return false;
  return room == 0 || static_cast<double>(room) > kWorthwhile * static_cast<double>(state_.held_at);
}

void Stepper::hold_count(std::int64_t count) {
  constexpr double kNoteworthy = 0.99;  // of the count logged before
  const std::int64_t before = std::exchange(state_.held_at, count);
  if (before > 0 && static_cast<double>(count) >= kNoteworthy * static_cast<double>(before)) return;
  training_.recorder.say("held at " + format_count(count) + " Gaussians: GPU memory");
  training_.recorder.log_event(state_.iteration, "held",
                               {{"reason", "GPU memory"},
                                {"count", count},
                                {"in_use_bytes", training_.memory->use().in_use},
                                {"limit_bytes", training_.memory->limit().value_or(0)}});
}

}  // namespace b3dgs
