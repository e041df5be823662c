// How many Gaussians a training has memory for: from what a Gaussian takes and what is there. Pure.
#pragma once

#include <cstdint>
#include <optional>

#include "raster/rasterizer.h"
#include "raster/view_memory.h"
#include "train/train_state.h"

namespace b3dgs {

/// Of a training's largest views.
struct ViewRatios {
  double splats = 1;  // seen Gaussians, of all
  double pairs = 4;   // (tile, splat) pairs for each Gaussian; the first view says more

  /// Takes a view into account.
  void add(const ViewSize& view, std::int64_t n_gaussians);
  /// Lets views count less that were long ago: to be called once a round of density control.
  void fade();

 private:
  bool is_measured_ = false;
};

/// Bytes of a Gaussian's parameters, moments and statistics.
std::int64_t state_row_bytes(const TrainState& state);
/// Of all of them, with room for rows that are not there yet.
std::int64_t state_bytes(const TrainState& state);

/// What a training takes for each Gaussian, bytes.
struct GaussianMemory {
  double state = 0;
  double step = 0;   // gradients by centres, steps that are put off
  double view = 0;   // rasterizer: what it keeps of a view, pairs included
  double round = 0;  // a round of density control: its plan, and the largest tensor a second time
  double all() const { return state + step + view + round; }
};
GaussianMemory gaussian_memory(const TrainState& state, const ViewMemory& view, const ViewRatios& ratios);

/// What is there for them, bytes.
struct CountLimits {
  std::int64_t limit = 0;  // MemorySource::limit()
  std::int64_t other = 0;  // what does not change with the number of Gaussians
};

/// The largest count for which that is enough, with a reserve of 1/32; at least 1.
std::int64_t largest_count(const CountLimits& limits, const GaussianMemory& gaussian);

/// The smaller of two limits of the count, where 0 stands for no limit.
std::int64_t smaller_limit(std::int64_t a, std::int64_t b);

}  // namespace b3dgs
