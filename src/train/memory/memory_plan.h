// How many Gaussians fit into memory, from the bytes that each one needs. Pure functions.
#pragma once

#include <algorithm>
#include <cstdint>
#include <optional>

#include "config/view_ratios.h"
#include "raster/view_memory.h"
#include "train/checkpoint/train_state.h"

namespace b3dgs {

/// Bytes of one Gaussian's parameters, moments and statistics.
std::int64_t state_row_bytes(const TrainState& state);
/// Bytes of all Gaussians, including spare capacity.
std::int64_t state_bytes(const TrainState& state);

/// Memory per Gaussian, bytes.
struct GaussianMemory {
  double state = 0;
  double step = 0;   // gradients with respect to projected centres, deferred updates
  double view = 0;   // the rasterizer's buffers for a view, including pairs
  double round = 0;  // a round of density control: its masks and indices, and a copy of the largest tensor
  /// The rasterizer's buffers are freed for a round if both do not fit.
  double all() const { return state + step + std::max(view, round); }
};
/// `n_kept_views`: views of a step whose gradients are kept.
GaussianMemory gaussian_memory(const TrainState& state, const ViewMemory& view, const ViewRatios& ratios,
                               int n_kept_views = 0);

/// Available memory, bytes.
struct CountLimits {
  std::int64_t limit = 0;  // MemorySource::limit()
  std::int64_t other = 0;  // in use, independent of the number of Gaussians
};

/// The largest number of Gaussians that fits, with a reserve of 1/16 of the limit; at least 1.
std::int64_t largest_count(const CountLimits& limits, const GaussianMemory& gaussian);

/// The smaller of two limits on the number of Gaussians; 0 = no limit.
std::int64_t smaller_limit(std::int64_t a, std::int64_t b);

}  // namespace b3dgs
