#include "train/memory_plan.h"

#include <algorithm>
#include <limits>

#include "config/coarse_schedule.h"
#include "train/step.h"
#include "train/team.h"
#include "train/training.h"

namespace b3dgs {
namespace {

ViewMemory memory_of_view(Training& training) {
  return view_memory(step_settings(training, training.state.iteration), training.largest_view);
}

GaussianMemory memory_of_gaussian(Training& training) {
  return gaussian_memory(training.state, memory_of_view(training), training.state.view_ratios,
                         keeps_gradients(training) ? training.config.batch : 0);
}

/// Returns the memory that the largest view needs for its pixels, in bytes, regardless of how many Gaussians it sees.
/// Images that the last steps have already allocated count only as far as they still have to grow (--coarse_scale).
std::int64_t memory_of_images(Training& training) {
  const double taken =
      training.empty_views.n_rendered() == 0 ? 0 : 1.0 / coarse_scale_at(training.config, training.state.iteration);
  const double to_come = (1 - taken * taken) * static_cast<double>(training.objective.bytes_per_pixel());
  const double n_pixels = static_cast<double>(training.largest_view.width) * training.largest_view.height;
  return static_cast<std::int64_t>(memory_of_view(training).of_image + to_come * n_pixels);
}

}  // namespace

MemoryForecast forecast_memory(Training& training, std::int64_t limit) {
  const GaussianMemory each = memory_of_gaussian(training);
  const auto n = static_cast<double>(training.state.gaussians.size());
  MemoryForecast forecast;
  forecast.limit = limit;
  forecast.model = static_cast<std::int64_t>(n * (each.state + each.step));
  forecast.pairs = static_cast<std::int64_t>(n * each.view);
  forecast.photographs = std::max<std::int64_t>(0, training.memory->use().in_use - state_bytes(training.state));
  forecast.images = memory_of_images(training);
  forecast.largest_count = largest_count(limit, forecast.photographs + forecast.images, each);
  return forecast;
}

std::optional<std::int64_t> gaussian_capacity(Training& training, Team& team) {
  constexpr std::int64_t kUnlimited = std::numeric_limits<std::int64_t>::max();
  const TrainState& state = training.state;
  std::int64_t count = kUnlimited;
  const std::optional<std::int64_t> limit = training.memory->limit();
  const std::int64_t n_own = state.gaussians.size();
  if (limit && n_own > 0) {
    const std::int64_t counted =
        state_bytes(state) + training.rasterizer.memory_bytes() + training.optimizer.kept_bytes();
    const std::int64_t others = std::max<std::int64_t>(0, training.memory->use().in_use - counted);
    count = largest_count(*limit, others + memory_of_images(training), memory_of_gaussian(training));
    // Scaled to the whole model, assuming that this process keeps its share. The process with the smallest result
    // decides.
    const double share = static_cast<double>(n_own) / static_cast<double>(state.n_gaussians());
    if (count != kUnlimited) count = static_cast<std::int64_t>(static_cast<double>(count) / share);
  }
  const std::int64_t least = -team.max("room", -count);
  return least == kUnlimited ? std::nullopt : std::optional(least);
}

}  // namespace b3dgs
