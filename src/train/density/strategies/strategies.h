// The density strategies, and their parts as stateless functions. `extent` is the scene extent, world units.
#pragma once

#include <cstdint>
#include <memory>

#include "config/train_config.h"
#include "raster/torch/rasterizer.h"
#include "train/density/density_strategy.h"
#include "train/density/row_edit.h"
#include "train/optimizer/adam.h"

namespace b3dgs {

// Adaptive density control of the original 3DGS (Kerbl et al. 2023, section 5): Gaussians with a large gradient of
// their projected centre are cloned if small and split if large; transparent and oversized ones are pruned; opacities
// are reset at intervals.

std::unique_ptr<DensityStrategy> make_default_strategy(const TrainConfig& config, double extent);

/// The schedule of the original; iterations are counted from 1.
DensityPlan density_plan(const TrainConfig& config, int iteration);

/// Whether opacities were reset within the last 500 iterations before this one, or within half the reset interval if
/// that is shorter. By then, most opacities have recovered.
bool is_after_opacity_reset(const TrainConfig& config, int iteration);

/// Thresholds of one round.
struct DensityRule {
  double grad_threshold = 0;       // Gaussians with at least this mean gradient norm are cloned or split
  double split_scale = 0;          // world units: larger Gaussians are split, others cloned
  double prune_opacity = 0;        // Gaussians below it are pruned
  double prune_scale = 0;          // world units; Gaussians above it are pruned; 0 = none
  double prune_radius = 0;         // px on screen; Gaussians above it are pruned; 0 = none
  std::int64_t max_gaussians = 0;  // 0 = no limit
};

DensityRule density_rule(const TrainConfig& config, double extent, int iteration);

/// One round, in the order of the original: clone small Gaussians with large gradients (exact copies), split large ones
/// (two samples of the parent replace it, 1.6 times smaller), then prune old and new rows. Clones of this round are not
/// split. If there are more candidates than max_gaussians allows, those with the largest gradients are taken; of equal
/// gradients, the first. The samples do not depend on the number of threads.
DensityRound densify(const GaussianTensors& gaussians, const DensityStatistics& statistics, const DensityRule& rule,
                     std::int64_t seed, int iteration);

/// Lowers every opacity to at most 0.01 and zeroes the Adam moments of the opacities. Adam's step count, shared by all
/// parameters, is kept, as in the original. Updates of opacities are never deferred, so no flush is needed.
void reset_opacities(GaussianTensors& gaussians, AdamState& adam);

// Strategy mcmc (Kheradmand et al. 2024, "3D Gaussian Splatting as Markov Chain Monte Carlo"): the number of Gaussians
// grows by a fixed fraction per round up to --max_gaussians. Gaussians that have become transparent move to opaque ones
// instead of being removed, in a way that preserves the image, and noise on the means lets them explore. There is no
// gradient threshold and no opacity reset.

std::unique_ptr<DensityStrategy> make_mcmc_strategy(const TrainConfig& config, double extent);

struct McmcRule {
  double prune_opacity = 0;        // Gaussians of at most this opacity are dead
  double growth = 0;               // fraction of the number of Gaussians to add
  std::int64_t max_gaussians = 0;  // 0 = no limit
};

/// One round. First each dead Gaussian is replaced by a copy of a live one, drawn in proportion to opacity; then
/// `growth` times the number of Gaussians are added as further copies, drawn in the same way, within max_gaussians. All
/// copies of a Gaussian, itself included, get the opacity and scales of mcmc_math.h and zero Adam moments. A moved
/// Gaussian counts as one pruned and one cloned. Without live Gaussians, the edit changes nothing. The result does not
/// depend on the number of threads.
DensityRound plan_mcmc_round(const GaussianTensors& gaussians, const McmcRule& rule, std::int64_t seed, int iteration);

/// Adds noise to the means (mcmc_math.h); `rate` is noise_lr times the learning rate of the means. `model_rows` as
/// DensityStrategy::after_step() has it: the noise of a Gaussian is that of its row of the model. Allocates nothing.
void add_mean_noise(GaussianTensors& gaussians, double rate, std::int64_t seed, int iteration,
                    const torch::Tensor& model_rows = {});

// Strategy budget: the number of Gaussians grows along a curve to a budget (--max_gaussians), by splitting Gaussians
// that contribute most to large errors. Uses ideas of FastGS (errors over several views) and Improved-GS (budget curve,
// splits along the longest axis); README.md says what a round does. Beside it, every --opacity_reset_interval
// iterations Gaussians are pruned whose blend weight was below --prune_weight in all views scored since the last such
// pruning, if at least kPruneViews saw them.

std::unique_ptr<DensityStrategy> make_budget_strategy(const TrainConfig& config, double extent);

/// Scored views that must have seen a Gaussian before it can be pruned for its blend weight, since it may be occluded
/// in many of them. A Gaussian that is visible in 30 % of them is occluded in all of 20 random ones with probability
/// 0.0008.
inline constexpr int kPruneViews = 20;

/// Columns of DensityStatistics::extra.
enum class BudgetColumn { kErrorSum, kMaxWeight, kScoreViews };

DensityPlan budget_plan(const TrainConfig& config, int iteration);

/// Whether Gaussians may be split in this iteration.
bool is_growth_round(const TrainConfig& config, int iteration);
/// Whether Gaussians are pruned for their blend weight in this iteration.
bool is_weight_prune_round(const TrainConfig& config, int iteration);

/// How many Gaussians a growth round adds to `n`. Their number follows n_0 + (budget - n_0) t^p, where t runs from 0 at
/// --densify_from_iter to 1 at the last growth round and p = 0.5. For this, each round adds the fraction
/// 1 - (1 - t^p) / (1 - t_before^p) of what is left to the budget, so that n_0 need not be stored.
std::int64_t budget_growth(const TrainConfig& config, int iteration, std::int64_t n, std::int64_t budget);

}  // namespace b3dgs
