// Density control within the available memory. If a round, or the views after it, would not fit, the number of
// Gaussians is held and training continues with the existing ones.

#include <algorithm>
#include <limits>

#include "core/text.h"
#include "train/trainer_impl.h"

namespace b3dgs {

void Trainer::Impl::control_density() {
  for (int iteration = first_of_step(); iteration <= state.iteration; ++iteration) control_density(iteration);
  state.is_density_pending = false;
}

void Trainer::Impl::control_density(int iteration) {
  const DensityPlan plan = density->plan(iteration);
  if (plan.densify) {
    recorder.report_progress("densifying");
    timer.start(StageTimes::Kind::kDensityRound);
    flush();
    run_density_round(iteration);
    timer.finish();
    if (state.n_gaussians() == 0) {
      is_consistent = false;
      throw NumericError(detail::concat("iteration ", state.iteration, ": density control removed the last Gaussian; ",
                                        "lower the learning rates"));
    }
  }
  if (plan.lower_opacities) density->lower_opacities(iteration, state.gaussians, state.adam);
}

GaussianMemory Trainer::Impl::memory_of_gaussian() {
  return gaussian_memory(state, view_memory(step_settings()), state.view_ratios,
                         keeps_views() || is_distributed() ? config.batch : 0);
}

std::optional<std::int64_t> Trainer::Impl::room_for_gaussians() {
  std::optional<std::int64_t> count;
  if (const std::optional<std::int64_t> limit = memory->limit()) {
    const std::int64_t counted = state_bytes(state) + rasterizer.memory_bytes() + stepper.kept_bytes();
    const CountLimits limits{*limit, std::max<std::int64_t>(0, memory->use().in_use - counted)};
    count = largest_count(limits, memory_of_gaussian());
  }
  if (!is_distributed()) return count;
  // Scaled to the whole model, as if each rank's share stayed the same; the smallest result counts.
  constexpr std::int64_t kUnlimited = std::numeric_limits<std::int64_t>::max();
  if (owners.n_own() == 0) count.reset();
  if (count) {
    const double share = static_cast<double>(owners.n_own()) / static_cast<double>(owners.n_rows());
    count = static_cast<std::int64_t>(static_cast<double>(*count) / share);
  }
  const std::int64_t least = -ranks->max("room", -count.value_or(kUnlimited));
  return least == kUnlimited ? std::nullopt : std::optional(least);
}

void Trainer::Impl::hold_count(std::int64_t count) {
  constexpr double kNoteworthy = 0.99;  // of the count logged before
  const bool is_news =
      state.held_at == 0 || static_cast<double>(count) < kNoteworthy * static_cast<double>(state.held_at);
  state.held_at = count;
  if (!is_news) return;
  recorder.say("held at " + format_count(count) + " Gaussians: GPU memory");
  recorder.log_event(state.iteration, "held",
                     {{"reason", "GPU memory"},
                      {"count", count},
                      {"in_use_bytes", memory->use().in_use},
                      {"limit_bytes", memory->limit().value_or(0)}});
}

bool Trainer::Impl::can_grow_again(std::int64_t room) const {
  // With less room, the count would be held again in every round.
  constexpr double kWorthwhile = 1.05;
  // A deterministic training must not depend on how much memory is free.
  if (config.deterministic || growth_has_failed) return false;
  return room == 0 || static_cast<double>(room) > kWorthwhile * static_cast<double>(state.held_at);
}

MemoryRemedy Trainer::Impl::together(MemoryRemedy remedy) {
  if (!is_distributed()) return remedy;
  return [this, remedy = std::move(remedy)] { return ranks->max("remedy", remedy() ? 1 : 0) != 0; };
}

void Trainer::Impl::plan_and_apply_round(int iteration, bool adds) {
  const std::int64_t before = state.n_gaussians();
  const std::int64_t room = room_for_gaussians().value_or(0);
  if (state.held_at > 0 && can_grow_again(room)) state.held_at = 0;
  const std::int64_t allowed = smaller_limit(config.max_gaussians, state.held_at);
  const std::int64_t limit = adds ? smaller_limit(allowed, room) : 1;
  const DensityRound round = is_distributed()
                                 ? plan_round_of_ranks(iteration, limit)
                                 : density->plan_round(state.gaussians, state.statistics, iteration, limit);
  if (adds && round.n_over_limit > 0 && limit != allowed) hold_count(std::max(room, before));

  if (is_distributed()) return apply_round_of_ranks(round, iteration, limit);
  reserve_rows(round.edit, limit);
  is_consistent = false;
  row_editor.apply(round.edit, state.gaussians, state.adam, state.statistics);
  density->end_round(iteration, state.statistics);
  is_consistent = true;
}

void Trainer::Impl::reserve_rows(const RowEdit& edit, std::int64_t limit) {
  const std::int64_t n_rows = edit.sources.size(0);
  constexpr std::int64_t kSparePart = 8;
  std::int64_t n_room = n_rows + n_rows / kSparePart;
  if (limit > 0) n_room = std::max(n_rows, std::min(n_room, limit));
  try {
    row_editor.reserve(edit, n_room, state.gaussians, state.adam, state.statistics);
  } catch (const OutOfMemoryError&) {
    if (n_room == n_rows) throw;
    row_editor.reserve(edit, n_rows, state.gaussians, state.adam, state.statistics);
  }
}

void Trainer::Impl::run_density_round(int iteration) {
  state.view_ratios.begin_round();
  model_ratios.begin_round();
  const std::vector<MemoryRemedy> remedies{together(wait_for_files()), together(free_scratch())};
  try {
    with_remedies(remedies, [&] { plan_and_apply_round(iteration); });
  } catch (const OutOfMemoryError&) {
    growth_has_failed = true;
    hold_count(state.n_gaussians());
    // Once more without growth: pruning still takes place.
    try {
      with_remedies(remedies, [&] { plan_and_apply_round(iteration); });
    } catch (const OutOfMemoryError&) {
      if (!is_distributed()) throw;
      // Even with as many Gaussians in all, one rank's part can grow. Once more without new ones.
      with_remedies(remedies, [&] { plan_and_apply_round(iteration, /*adds=*/false); });
    }
  }
  has_failed_together = false;
  if (is_distributed() && owners.are_uneven()) redistribute_rows();
  trim_memory();
}

MemoryRemedy Trainer::Impl::wait_for_files() {
  return [this] {
    if (!recorder.is_writing()) return false;
    recorder.wait_for_files();  // frees the copies on the device that they are written from
    return true;
  };
}

MemoryRemedy Trainer::Impl::free_scratch() {
  return [this] {
    rasterizer.release_memory();
    memory->release_unused();
    return true;
  };
}

MemoryRemedy Trainer::Impl::release_photographs() {
  return [this] {
    // About the size of the model's largest tensor, since the next views may need that much again.
    constexpr std::int64_t kAtLeast = std::int64_t{256} << 20;
    const std::int64_t freed = images.release_resident(std::max(kAtLeast, state_bytes(state) / 4));
    if (freed == 0) return false;
    memory->release_unused();
    recorder.say("fewer photographs stay on the GPU: memory is short");
    return true;
  };
}

void Trainer::Impl::trim_memory() {
  if (keeps_too_much(memory->use())) memory->release_unused();
}

std::optional<MemoryForecast> Trainer::forecast_memory() {
  Impl& impl = *impl_;
  const std::optional<std::int64_t> limit = impl.memory->limit();
  if (!limit) return std::nullopt;
  if (impl.state.gaussians.size() == 0) impl.initialize_model();
  const GaussianMemory each = impl.memory_of_gaussian();
  const double n = static_cast<double>(impl.state.gaussians.size());
  const MemoryUse use = impl.memory->use();
  MemoryForecast forecast;
  forecast.limit = *limit;
  forecast.model = static_cast<std::int64_t>(n * (each.state + each.step));
  forecast.pairs = static_cast<std::int64_t>(n * each.view);
  forecast.photographs = std::max<std::int64_t>(0, use.in_use - state_bytes(impl.state));
  forecast.largest_count = largest_count({*limit, forecast.photographs}, each);
  return forecast;
}

}  // namespace b3dgs
