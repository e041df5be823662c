// The memory that a training needs, from the views that it has rendered.
#pragma once

#include <cstdint>
#include <optional>

#include "train/memory/memory.h"

namespace b3dgs {

class Team;
struct Training;

/// A forecast for a GPU before the first step, in bytes besides the CUDA context.
struct MemoryForecast {
  std::int64_t limit = 0;          // what training may use
  std::int64_t photographs = 0;    // those that stay on the GPU
  std::int64_t model = 0;          // parameters, moments and statistics at the initial count
  std::int64_t pairs = 0;          // splats and (tile, splat) pairs of a view of that model
  std::int64_t images = 0;         // what is stored for each pixel of the largest view
  std::int64_t largest_count = 0;  // Gaussians that fit
};

/// `limit`: MemorySource::limit().
MemoryForecast forecast_memory(Training& training, std::int64_t limit);

/// Returns the number of Gaussians of the model for which there is memory; nothing if memory is not limited.
std::optional<std::int64_t> gaussian_capacity(Training& training, Team& team);

}  // namespace b3dgs
