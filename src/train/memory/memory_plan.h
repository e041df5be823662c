// How many Gaussians a training has memory for: from what a Gaussian takes and what is there. Pure.
#pragma once

#include <algorithm>
#include <cstdint>
#include <optional>

#include "raster/torch/rasterizer.h"
#include "raster/view_memory.h"
#include "train/checkpoint/train_state.h"

namespace b3dgs {

/// How much views show of a model: of the largest ones since the round of density control before the last one. Earlier
/// ones say nothing, for Gaussians become smaller as they become more.
class ViewRatios {
 public:
  void add(const ViewSize& view, std::int64_t n_gaussians);
  /// To be called at each round of density control.
  void begin_round();
  /// Seen Gaussians, of all; 1 before the first view.
  double splats() const { return ratio(&Largest::splats, 1); }
  /// (tile, splat) pairs for each Gaussian; a guess before the first view.
  double pairs() const { return ratio(&Largest::pairs, 4); }

 private:
  struct Largest {
    double splats = 0, pairs = 0;
  };
  double ratio(double Largest::*which, double unknown) const {
    const double largest = std::max(before_.*which, now_.*which);
    return largest > 0 ? largest : unknown;
  }
  Largest before_, now_;
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
  /// What is kept of views gives way to a round where both do not fit.
  double all() const { return state + step + std::max(view, round); }
};
GaussianMemory gaussian_memory(const TrainState& state, const ViewMemory& view, const ViewRatios& ratios);

/// What is there for them, bytes.
struct CountLimits {
  std::int64_t limit = 0;  // MemorySource::limit()
  std::int64_t other = 0;  // what does not change with the number of Gaussians
};

/// The largest count for which that is enough, with a reserve of 1/16; at least 1.
std::int64_t largest_count(const CountLimits& limits, const GaussianMemory& gaussian);

/// The smaller of two limits of the count, where 0 stands for no limit.
std::int64_t smaller_limit(std::int64_t a, std::int64_t b);

}  // namespace b3dgs
