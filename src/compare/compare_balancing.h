// What balancing brings by itself: where a balanced forward kernel stands among others that differ from it in nothing
// but forward kernels.
#pragma once

#include <cstddef>
#include <optional>
#include <string>
#include <vector>

#include "report/time_saved.h"

namespace b3dgs {

/// The three steps from naive over the best unbalanced kernel to a balanced one (or a choice that may use one).
struct BalancingGain {
  std::string name, naive, unbalanced;   // configurations; `unbalanced` is the fastest whose kernel is not balanced
  Spread ours_s, naive_s, unbalanced_s;  // seconds
  Spread to_unbalanced;                  // saved from naive to unbalanced, share of naive's time
  Spread balancing;                      // from unbalanced to ours, share of unbalanced's time: what balancing brings
  Spread whole;                          // from naive to ours, share of naive's time
};

/// Of configurations[index], over the iterations that all have done by seed. Nothing if it has no balanced kernel, or
/// if one of the unbalanced kernels was not trained with the same options.
std::optional<BalancingGain> balancing_gain(const std::vector<ConfigurationHistory>& configurations,
                                              std::size_t index, const std::vector<int>& done_by_seed);

/// Kernels that are not balanced and that no configuration has which differs from `ours` in nothing but forward
/// kernels.
std::vector<std::string> missing_unbalanced_kernels(const std::vector<ConfigurationHistory>& configurations,
                                                    const TrainConfig& ours);

/// Whether the forward kernel is balanced, or chosen from some of which one is.
bool may_balance(const TrainConfig& config);

/// Whether what `ours` saves of `baseline`'s time can stand beside the paper's figures: naive against the choice
/// between combined and shared-memory, both with the backward pass of the original.
bool is_paper_pair(const TrainConfig& baseline, const TrainConfig& ours);

}  // namespace b3dgs
