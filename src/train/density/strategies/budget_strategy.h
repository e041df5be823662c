// Strategy budget: the number of Gaussians grows along a curve to a budget (--max_gaussians), by splitting Gaussians
// that contribute most to large errors. Uses ideas of FastGS (errors over several views) and Improved-GS (budget curve,
// splits along the longest axis); see docs/recipes.md.
//
//   score        sum of blend weight times squared pixel error over the last --score_views steps before a round
//   parents      drawn from the Gaussians with a score, in proportion to it
//   parts        --split: the two Gaussians that replace a parent; their Adam moments are 0
//   growth       budget_growth(): how far each round goes towards the budget
//   pruning      in each round, opacity < 0.005; every --opacity_reset_interval iterations, also blend weight
//                < --prune_weight in all views scored since the last such pruning, if at least kPruneViews saw it
#pragma once

#include <cstdint>
#include <memory>

#include "config/train_config.h"
#include "train/density/density_strategy.h"

namespace b3dgs {

std::unique_ptr<DensityStrategy> make_budget_strategy(const TrainConfig& config, double extent);

// The strategy's parts, as stateless functions that tests can call.

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
