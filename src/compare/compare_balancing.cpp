#include "compare/compare_balancing.h"

#include <algorithm>

#include "compare/compare_config.h"

namespace b3dgs {
namespace {

/// The first configuration with this fixed kernel that differs from `ours` only in the forward kernel, or null.
const ConfigurationHistory* find_kernel(const std::vector<ConfigurationHistory>& configurations,
                                        const TrainConfig& ours, std::string_view kernel) {
  const auto found = std::find_if(configurations.begin(), configurations.end(), [&](const ConfigurationHistory& own) {
    return own.config.kernel == kernel && differing_options(own.config, ours).others.empty();
  });
  return found == configurations.end() ? nullptr : &*found;
}

std::vector<double> seconds_of(const ConfigurationHistory& configuration, const std::vector<int>& done_by_seed) {
  std::vector<double> seconds;
  for (std::size_t seed = 0; seed < done_by_seed.size(); ++seed) {
    if (done_by_seed[seed] > 0) seconds.push_back(elapsed_at(configuration.by_seed[seed], done_by_seed[seed]));
  }
  return seconds;
}

Effect saved_by_seed(const std::vector<double>& before_s, const std::vector<double>& after_s,
                     const EffectLimits& limits) {
  std::vector<double> saved;
  for (std::size_t i = 0; i < before_s.size(); ++i) saved.push_back(saved_share(before_s[i], after_s[i]));
  return *effect_of(saved, limits);
}

}  // namespace

bool may_balance(const TrainConfig& config) {
  const std::vector<std::string> kernels = forward_candidates(config);
  return std::any_of(kernels.begin(), kernels.end(), [](const std::string& name) { return is_balanced_kernel(name); });
}

std::vector<std::string> missing_unbalanced_kernels(const std::vector<ConfigurationHistory>& configurations,
                                                    const TrainConfig& ours) {
  std::vector<std::string> missing;
  for (const ForwardKernelName& row : kForwardKernels) {
    if (!row.is_balanced && find_kernel(configurations, ours, row.name) == nullptr) missing.emplace_back(row.name);
  }
  return missing;
}

std::optional<BalancingGain> balancing_gain(const std::vector<ConfigurationHistory>& configurations, std::size_t index,
                                            const std::vector<int>& done_by_seed, const std::optional<double>& noise) {
  const ConfigurationHistory& ours = configurations[index];
  if (!may_balance(ours.config) || !missing_unbalanced_kernels(configurations, ours.config).empty()) {
    return std::nullopt;
  }
  const std::vector<double> ours_s = seconds_of(ours, done_by_seed);
  if (ours_s.empty()) return std::nullopt;
  std::vector<double> naive_s, unbalanced_s;
  BalancingGain gain;
  gain.name = ours.name;
  for (const ForwardKernelName& row : kForwardKernels) {
    if (row.is_balanced) continue;
    const ConfigurationHistory& own = *find_kernel(configurations, ours.config, row.name);
    const std::vector<double> own_s = seconds_of(own, done_by_seed);
    if (*std::min_element(own_s.begin(), own_s.end()) <= 0) return std::nullopt;
    if (row.kernel == ForwardKernel::kNaive) {
      naive_s = own_s;
      gain.naive = own.name;
    }
    if (!unbalanced_s.empty() && spread_of(own_s)->mean >= spread_of(unbalanced_s)->mean) continue;
    unbalanced_s = own_s;
    gain.unbalanced = own.name;
  }
  gain.ours_s = *spread_of(ours_s);
  gain.naive_s = *spread_of(naive_s);
  gain.unbalanced_s = *spread_of(unbalanced_s);
  const EffectLimits limits = time_limits(noise);
  gain.to_unbalanced = saved_by_seed(naive_s, unbalanced_s, limits);
  gain.balancing = saved_by_seed(unbalanced_s, ours_s, limits);
  gain.whole = saved_by_seed(naive_s, ours_s, limits);
  return gain;
}

bool is_paper_pair(const TrainConfig& baseline, const TrainConfig& ours) {
  TrainConfig published = ours;
  published.kernel = kPublishedKernel;
  return baseline.kernel == forward_kernel_name(ForwardKernel::kNaive) &&
         baseline.backward_kernel == backward_kernel_name(BackwardKernel::kPerPixel) && chooses_forward_kernel(ours) &&
         forward_candidates(ours) == forward_candidates(published) && differing_options(baseline, ours).others.empty();
}

}  // namespace b3dgs
