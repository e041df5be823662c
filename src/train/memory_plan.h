// Forecasts of the GPU memory that a training needs, based on the views that it has rendered.
#pragma once

#include <cstdint>
#include <optional>

#include "train/memory/memory.h"

namespace b3dgs {

class Team;
struct Training;

/// Forecast for a GPU before the first step, in bytes without the CUDA context.
struct MemoryForecast {
  std::int64_t limit = 0;          // maximum for training
  std::int64_t photographs = 0;    // photographs that stay on the GPU
  std::int64_t model = 0;          // parameters, moments and statistics at the initial count
  std::int64_t pairs = 0;          // splats and (tile, splat) pairs of a view at the initial count
  std::int64_t images = 0;         // per-pixel data of the largest view
  std::int64_t largest_count = 0;  // number of Gaussians that fit
};

/// Returns the forecast. `limit` is MemorySource::limit().
MemoryForecast forecast_memory(Training& training, std::int64_t limit);

/// Returns the number of Gaussians of the whole model that fit into memory, or nothing if memory is not limited. All
/// processes call this together.
std::optional<std::int64_t> gaussian_capacity(Training& training, Team& team);

}  // namespace b3dgs
