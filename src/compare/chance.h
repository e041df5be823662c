// Means over seeds, and whether a difference is more than chance.
#pragma once

#include <nlohmann/json.hpp>
#include <optional>
#include <vector>

namespace b3dgs {

/// docs/compare.md names all limits, too.
struct EffectLimits {
  double floor = 0;     // several seeds: a smaller mean difference never counts, however certain
  double one_seed = 0;  // one seed: a smaller difference may be chance
};

/// The limit for one seed if two runs of the baseline differ by `noise`: another pair of equal runs differs by over
/// t(1) = 12.7 x `noise` in 5 of 100 comparisons.
double limit_with_noise(double noise);

/// Of the share of time saved. `noise`: that of two runs of the baseline, if it was trained twice.
EffectLimits time_limits(const std::optional<double>& noise);

/// {"mean", "min", "max", "n"}; null without values.
nlohmann::ordered_json spread_of(const std::vector<double>& values);

/// A spread with "interval", "limit" and "finding" (compare_summary.h); null without values.
nlohmann::ordered_json effect_of(const std::vector<double>& differences, const EffectLimits& limits);

}  // namespace b3dgs
