// Adaptive density control of the original 3DGS: where the image pulls at a Gaussian, clone it if it is small and split
// it if it is large; remove what is transparent or too large. Pure: numbers in, a RowEdit out.
#pragma once

#include <cstdint>

#include "raster/torch/gaussian_tensors.h"
#include "train/config/train_config.h"
#include "train/density/density_statistics.h"
#include "train/density/row_edit.h"
#include "train/optimizer/adam.h"

namespace b3dgs {

/// What density control does after the optimiser's step of an iteration.
struct DensityPlan {
  bool add_statistics = false;
  bool densify = false;
  bool reset_opacities = false;
};

/// The original's schedule; iterations count from 1.
DensityPlan density_plan(const TrainConfig& config, int iteration);

/// Whether opacities were reset within the last 500 iterations before this one (or half the interval between two
/// resets, if that is less): until then most have not found back to what they will be.
bool is_after_opacity_reset(const TrainConfig& config, int iteration);

/// Thresholds of one round.
struct DensityRule {
  double grad_threshold = 0;       // mean gradient from which a Gaussian grows, units of half the image
  double split_scale = 0;          // world units: with a larger scale it is split, else cloned
  double prune_opacity = 0;        // below: removed
  double prune_scale = 0;          // world units, above: removed; 0: none for its size
  double prune_radius = 0;         // px, above: removed; 0: none for its size on screen
  std::int64_t max_gaussians = 0;  // growth stops here; 0: no limit
};

/// `extent` is the scene's, world units.
DensityRule density_rule(const TrainConfig& config, double extent, int iteration);

struct DensityRound {
  RowEdit edit;
  std::int64_t n_cloned = 0, n_split = 0, n_pruned = 0;
  std::int64_t n_refused = 0;  // candidates for which max_gaussians left no room
};

/// One round, in the original's order: clones (exact copies) from the gradients, then splits (the parent makes way for
/// 2 samples of itself, 1.6 times smaller), which never touch this round's clones, then pruning of old and new alike.
/// Where there are more candidates than max_gaussians leaves room for, those of largest gradient grow, and of equal
/// ones the first. Samples are drawn by row: the same for any number of threads.
DensityRound densify(const GaussianTensors& gaussians, const DensityStatistics& statistics, const DensityRule& rule,
                     std::int64_t seed, int iteration);

/// Takes every opacity down to 0.01 and forgets the moments of that group.
void reset_opacities(GaussianTensors& gaussians, AdamState& adam);

}  // namespace b3dgs
