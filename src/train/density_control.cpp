#include "train/density_control.h"

#include <algorithm>
#include <utility>
#include <vector>

#include "core/text.h"
#include "train/memory/memory.h"
#include "train/memory_plan.h"

namespace b3dgs {
namespace {

/// Returns the smaller of two limits on the number of Gaussians, where 0 means no limit.
std::int64_t smaller_limit(std::int64_t a, std::int64_t b) {
  return a == 0 || b == 0 ? std::max(a, b) : std::min(a, b);
}

}  // namespace

void DensityControl::run() {
  for (; state_.n_density_pending > 0; --state_.n_density_pending) {
    const int iteration = state_.iteration - state_.n_density_pending + 1;
    const DensityPlan plan = training_.density->plan(iteration);
    if (plan.densify) {
      training_.recorder.report_progress("densifying");
      training_.timer.start(StageTimes::Kind::kDensityRound);
      training_.flush();
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

void DensityControl::run_round(int iteration) {
  state_.view_ratios.begin_round();
  const auto together = [&](MemoryRemedy remedy) -> MemoryRemedy {  // all processes retry if it helped any of them
    return [this, remedy = std::move(remedy)] { return team_.max("remedy", remedy() ? 1 : 0) != 0; };
  };
  const std::vector<MemoryRemedy> remedies{together(training_.waiting_for_files()),
                                           together(training_.freeing_scratch())};
  // The second attempt prunes but does not grow the model. Even with an unchanged total, one of several processes may
  // then need more memory, so the third attempt adds no Gaussians at all.
  for (int n_failures = 0;; ++n_failures) {
    try {
      with_remedies(remedies, [&] { plan_and_apply(iteration, /*adds=*/n_failures < 2); });
      break;
    } catch (const OutOfMemoryError&) {
      if (n_failures == 2) throw;
      growth_has_failed_ = true;
      if (n_failures == 0) cap_count(state_.n_gaussians());
    }
  }
  training_.trim_memory();
}

void DensityControl::plan_and_apply(int iteration, bool adds) {
  const std::int64_t before = state_.n_gaussians();
  const std::int64_t capacity = gaussian_capacity(training_, team_).value_or(0);
  if (state_.count_cap > 0 && can_grow_again(capacity)) state_.count_cap = 0;
  const std::int64_t allowed = smaller_limit(training_.config.max_gaussians, state_.count_cap);
  const std::int64_t limit = adds ? smaller_limit(allowed, capacity) : 1;  // 1: below any number, so none is added
  team_.run_round(iteration, limit, [&](const DensityRound& round) {
    if (adds && round.n_over_limit > 0 && limit != allowed) cap_count(std::max(capacity, before));
  });
}

bool DensityControl::can_grow_again(std::int64_t capacity) const {
  // Growing for less than 5 % would start and end a cap in every round.
  constexpr double kWorthwhile = 1.05;
  if (training_.config.deterministic || growth_has_failed_) return false;
  return capacity == 0 || static_cast<double>(capacity) > kWorthwhile * static_cast<double>(state_.count_cap);
}

void DensityControl::cap_count(std::int64_t count) {
  constexpr double kNoteworthy = 0.99;  // caps of at least this fraction of the previous one are not logged
  const std::int64_t before = std::exchange(state_.count_cap, count);
  if (before > 0 && static_cast<double>(count) >= kNoteworthy * static_cast<double>(before)) return;
  training_.recorder.say("capped at " + format_count(count) + " Gaussians: GPU memory");
  training_.recorder.log_event(state_.iteration, "capped",
                               {{"reason", "GPU memory"},
                                {"count", count},
                                {"in_use_bytes", training_.memory->use().in_use},
                                {"limit_bytes", training_.memory->limit().value_or(0)}});
}

void reserve_rows(Training& training, const RowEdit& edit, std::int64_t limit) {
  TrainState& state = training.state;
  const std::int64_t n_rows = edit.sources.size(0);
  constexpr std::int64_t kSparePart = 8;
  std::int64_t n_room = n_rows + n_rows / kSparePart;
  if (limit > 0) n_room = std::max(n_rows, std::min(n_room, limit));
  try {
    training.row_editor.reserve(edit, n_room, state.gaussians, state.adam, state.statistics);
  } catch (const OutOfMemoryError&) {
    if (n_room == n_rows) throw;
    training.row_editor.reserve(edit, n_rows, state.gaussians, state.adam, state.statistics);
  }
}

void apply_reserved(Training& training, const RowEdit& edit, int iteration) {
  TrainState& state = training.state;
  training.is_consistent = false;
  training.row_editor.apply(edit, state.gaussians, state.adam, state.statistics);
  training.density->end_round(iteration, state.statistics);
  training.is_consistent = true;
}

}  // namespace b3dgs
