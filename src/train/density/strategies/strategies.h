// The density strategies and their parts as stateless functions. `extent` is the scene extent in world units.
#pragma once

#include <cstdint>
#include <memory>

#include "train/density/density_strategy.h"

namespace b3dgs {

/// Returns whether any strategy may add Gaussians in this iteration.
inline bool is_growth_round(const TrainConfig& config, int iteration) {
  return iteration > config.densify_from_iter && iteration < config.densify_until_iter &&
         iteration % config.densification_interval == 0;
}

// Adaptive density control of the original 3DGS (Kerbl et al. 2023, section 5). Gaussians with a large gradient of
// their projected centre are cloned if they are small and split if they are large. Transparent and oversized Gaussians
// are pruned, and opacities are reset at intervals.

std::unique_ptr<DensityStrategy> make_default_strategy(const TrainConfig& config, double extent);

// Strategy mcmc (Kheradmand et al. 2024, "3D Gaussian Splatting as Markov Chain Monte Carlo"). The number of Gaussians
// grows by a fixed fraction per round up to --max_gaussians. Gaussians that have become transparent are not removed but
// moved to opaque ones, in a way that preserves the image, and noise on the means lets them explore the scene.

std::unique_ptr<DensityStrategy> make_mcmc_strategy(const TrainConfig& config, double extent);

struct McmcRule {
  double prune_opacity = 0;        // Gaussians with at most this opacity are dead
  double growth = 0;               // number of Gaussians to add, as a fraction of those present
  std::int64_t max_gaussians = 0;  // 0 = no limit
};

/// Plans one round (README.md). All copies of a Gaussian, itself included, get the opacity and scales of mcmc_math.h
/// and zero Adam moments. A moved Gaussian counts as one pruned and one cloned. If no Gaussian is live, the edit
/// changes nothing. The result does not depend on the number of threads.
DensityRound plan_mcmc_round(const GaussianTensors& gaussians, const McmcRule& rule, std::int64_t seed, int iteration);

/// Adds noise to the means (mcmc_math.h). `rate` is noise_lr times the learning rate of the means. For `model_rows` see
/// DensityStrategy::after_step(). The noise of a Gaussian depends on its index in the whole model. Allocates nothing.
void add_mean_noise(GaussianTensors& gaussians, double rate, std::int64_t seed, int iteration,
                    const torch::Tensor& model_rows = {});

// Strategy budget. The number of Gaussians grows along a curve to a budget (--max_gaussians), by splitting Gaussians
// that contribute most to large errors. It combines ideas of FastGS (errors over several views) and Improved-GS (budget
// curve, splits along the longest axis). README.md describes a round. In addition, every --opacity_reset_interval
// iterations Gaussians are pruned whose blend weight was below --prune_weight in all views scored since the last such
// pruning, if they were visible in at least 20 of them.

std::unique_ptr<DensityStrategy> make_budget_strategy(const TrainConfig& config, double extent);

/// Indices into DensityStatistics::extra.
enum class BudgetColumn { kErrorSum, kMaxWeight, kScoreViews };

/// Returns how many Gaussians a growth round adds to `n`. The number follows n_0 + (budget - n_0) t^p, where t runs
/// from 0 at --densify_from_iter to 1 at the last growth round and p = 0.5. Each round therefore adds the fraction 1 -
/// (1 - t^p) / (1 - t_before^p) of the difference to the budget, so that n_0 need not be stored.
std::int64_t budget_growth(const TrainConfig& config, int iteration, std::int64_t n, std::int64_t budget);

}  // namespace b3dgs
