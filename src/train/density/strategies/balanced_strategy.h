// Strategy balanced: the count grows to a budget (--max_gaussians) along a curve, and the Gaussians that are split are
// those blended into large errors. After ideas of AbsGS (absolute gradients), FastGS (errors over several views) and
// Improved-GS (budget curve, split along the longest axis); docs/recipes.md.
//
// Each part is a switch of its own:
//   score        error_sum: over the last --score_views steps before a round, sum of blend weight times pixel error
//                (--score_power)
//   candidates   mean absolute gradient >= --abs_grad_threshold, and a score
//   parents      --parents: drawn in proportion to the score, or the highest
//   parts        --split; the parent is removed, and two parts with zero moments are added
//   count        each round closes its share of the distance to the budget (--budget_power)
//   pruning      opacity < --prune_opacity in each round; every --prune_interval iterations Gaussians whose blend
//   weight
//                stayed below --prune_weight in all scored views since the last time, if there were enough of these
//   opacities    no resets; --opacity_decay
//   noise        on the means, as in mcmc (--noise_lr)
#pragma once

#include <cstdint>
#include <memory>

#include "config/train_config.h"
#include "train/density/density_strategy.h"

namespace b3dgs {

/// `extent`: the scene extent, world units; only the learning rates depend on it. @throws LogicError for an unknown
/// --parents or --split
std::unique_ptr<DensityStrategy> make_balanced_strategy(const TrainConfig& config, double extent);

// Its parts, as functions of their arguments alone.

/// Scored views that must have seen a Gaussian before it is removed for its blend weight: other parts of the scene may
/// hide it in many of them. One that 30 % of the views show is hidden in 20 random ones with probability 0.0008.
inline constexpr int kPruneViews = 20;

/// Columns of DensityStatistics::extra.
enum class BalancedColumn { kAbsGradSum, kErrorSum, kMaxWeight, kScoreViews };

DensityPlan balanced_plan(const TrainConfig& config, int iteration);

/// Whether the count may grow in this iteration, and whether Gaussians are removed for their blend weight.
bool is_growth_round(const TrainConfig& config, int iteration);
bool is_weight_prune_round(const TrainConfig& config, int iteration);

/// How many Gaussians a growth round adds to `n`. With t the share of the time from --densify_from_iter to the last
/// round, and p = --budget_power, the count follows n_0 + (budget - n_0) t^p: each round closes the share
/// 1 - (1 - t^p) / (1 - t_before^p) of the distance that is left, which needs no memory of n_0.
std::int64_t budget_growth(const TrainConfig& config, int iteration, std::int64_t n, std::int64_t budget);

}  // namespace b3dgs
