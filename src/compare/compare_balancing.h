// The time that load balancing alone saves: a configuration with load-balanced forward kernels against configurations
// that differ from it only in the forward kernel.
#pragma once

#include <cstddef>
#include <optional>
#include <string>
#include <vector>

#include "compare/compare_effect.h"

namespace b3dgs {

/// Splits the time saved by a load-balanced configuration (a balanced kernel, or a choice that includes one) in two:
/// from naive to the fastest kernel without load balancing, and from there to the balanced configuration.
struct BalancingGain {
  std::string name, naive, unbalanced;   // configurations; `unbalanced` has the fastest kernel without balancing
  Spread ours_s, naive_s, unbalanced_s;  // seconds
  Effect to_unbalanced;                  // saved by `unbalanced`, share of naive's time
  Effect balancing;                      // saved by load balancing, share of `unbalanced`'s time
  Effect whole;                          // saved in total, share of naive's time
};

/// For configurations[index], over the first done_by_seed[i] iterations of seed i. `noise`: see time_limits(). nullopt
/// if the configuration has no balanced kernel, or if a kernel without load balancing was not trained with the same
/// other options.
std::optional<BalancingGain> balancing_gain(const std::vector<ConfigurationHistory>& configurations, std::size_t index,
                                            const std::vector<int>& done_by_seed, const std::optional<double>& noise);

/// Kernels without load balancing for which no configuration differs from `ours` only in the forward kernel.
std::vector<std::string> missing_unbalanced_kernels(const std::vector<ConfigurationHistory>& configurations,
                                                    const TrainConfig& ours);

/// Whether the forward kernel is load-balanced, or chosen from candidates that include a load-balanced one.
bool may_balance(const TrainConfig& config);

/// Whether the two are the comparison in the Balanced3DGS paper (arXiv:2412.17378): naive against the choice between
/// combined and shared-memory, both with the backward pass of the original 3DGS trainer (per-pixel).
bool is_paper_pair(const TrainConfig& baseline, const TrainConfig& ours);

}  // namespace b3dgs
