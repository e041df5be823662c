// Rounds of density control within the memory that there is. The count is held before a round or the views after it
// would fail: that ends no training, it goes on with the Gaussians that it has.

#include <algorithm>

#include "core/text.h"
#include "train/density/original_strategy.h"
#include "train/trainer_impl.h"

namespace b3dgs {

std::optional<std::int64_t> Trainer::Impl::room_for_gaussians() {
  const std::optional<std::int64_t> limit = memory->limit();
  if (!limit) return std::nullopt;
  const std::int64_t counted = state_bytes(state) + rasterizer.memory_bytes();
  const CountLimits limits{*limit, std::max<std::int64_t>(0, memory->use().in_use - counted)};
  return largest_count(limits, gaussian_memory(state, view_memory(step_settings()), view_ratios));
}

void Trainer::Impl::hold_count(std::int64_t count) {
  constexpr double kNoteworthy = 0.99;  // of what was said before
  const bool is_news =
      state.held_at == 0 || static_cast<double>(count) < kNoteworthy * static_cast<double>(state.held_at);
  state.held_at = count;
  if (!is_news) return;
  say("held at " + format_count(count) + " Gaussians: GPU memory");
  if (log == nullptr) return;
  const MemoryUse use = memory->use();
  log->write_event(state.iteration, "held",
                   {{"reason", "GPU memory"},
                    {"count", count},
                    {"in_use_bytes", use.in_use},
                    {"limit_bytes", memory->limit().value_or(0)}});
}

bool Trainer::Impl::can_grow_on(std::int64_t room) const {
  // Less would be a hold at each round. A course that has to be the same twice does not depend on what is free.
  constexpr double kWorthwhile = 1.05;
  if (config.deterministic || growth_has_failed) return false;
  return room == 0 || static_cast<double>(room) > kWorthwhile * static_cast<double>(state.held_at);
}

void Trainer::Impl::densify_model() {
  const std::int64_t before = state.gaussians.size();
  const std::int64_t room = room_for_gaussians().value_or(0);
  if (state.held_at > 0 && can_grow_on(room)) state.held_at = 0;
  const std::int64_t allowed = smaller_limit(config.max_gaussians, state.held_at);
  DensityRule rule = density_rule(config, scene.extent, state.iteration);
  rule.max_gaussians = smaller_limit(allowed, room);
  const DensityRound round = densify(state.gaussians, state.statistics, rule, config.seed, state.iteration);
  if (round.n_refused > 0 && rule.max_gaussians != allowed) hold_count(std::max(room, before));

  const std::int64_t n_rows = round.edit.sources.size(0);
  // A part more, so that most rounds move no tensor; not where that would take what others need.
  constexpr std::int64_t kSparePart = 8;
  std::int64_t n_room = n_rows + n_rows / kSparePart;
  if (rule.max_gaussians > 0) n_room = std::max(n_rows, std::min(n_room, rule.max_gaussians));
  try {
    row_editor.reserve(round.edit, n_room, state.gaussians, state.adam, state.statistics);
  } catch (const OutOfMemoryError&) {
    if (n_room == n_rows) throw;
    row_editor.reserve(round.edit, n_rows, state.gaussians, state.adam, state.statistics);
  }
  is_whole = false;
  row_editor.apply(round.edit, state.gaussians, state.adam, state.statistics);
  for (torch::Tensor* statistic : state.statistics.all()) statistic->zero_();
  is_whole = true;
}

void Trainer::Impl::grow() {
  view_ratios.begin_round();
  try {
    with_remedies({wait_for_files(), free_scratch()}, [&] { densify_model(); });
  } catch (const OutOfMemoryError&) {
    growth_has_failed = true;
    hold_count(state.gaussians.size());
    with_remedies({wait_for_files(), free_scratch()},
                  [&] { densify_model(); });  // what is to be removed is removed all the same
  }
  trim_memory();
}

MemoryRemedy Trainer::Impl::wait_for_files() {
  return [this] {
    if (!writer.is_busy()) return false;
    writer.wait();  // what they are written from may be a copy
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
    // As much as the model's largest tensor, or what there is: views can ask for that once more.
    constexpr std::int64_t kAtLeast = std::int64_t{256} << 20;
    const std::int64_t freed = images.release_resident(std::max(kAtLeast, state_bytes(state) / 4));
    if (freed == 0) return false;
    memory->release_unused();
    say("fewer photographs stay on the GPU: memory");
    return true;
  };
}

void Trainer::Impl::trim_memory() {
  if (keeps_too_much(memory->use())) memory->release_unused();
}

std::optional<MemoryForecast> Trainer::forecast_memory() {
  Impl& own = *impl_;
  const std::optional<std::int64_t> limit = own.memory->limit();
  if (!limit) return std::nullopt;
  if (own.state.gaussians.size() == 0) own.start();
  const GaussianMemory each = gaussian_memory(own.state, view_memory(own.step_settings()), own.view_ratios);
  const double n = static_cast<double>(own.state.gaussians.size());
  const MemoryUse use = own.memory->use();
  MemoryForecast forecast;
  forecast.limit = *limit;
  forecast.model = static_cast<std::int64_t>(n * (each.state + each.step));
  forecast.pairs = static_cast<std::int64_t>(n * each.view);
  forecast.photographs = std::max<std::int64_t>(0, use.in_use - state_bytes(own.state));
  forecast.largest_count = largest_count({*limit, forecast.photographs}, each);
  return forecast;
}

}  // namespace b3dgs
