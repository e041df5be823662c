// Means over seeds, and tests whether a difference is more than chance.
#pragma once

#include <nlohmann/json.hpp>
#include <optional>
#include <vector>

namespace b3dgs {

/// The smallest significant differences. docs/compare.md lists them too.
struct Measure {
  double floor = 0;       // several seeds: a smaller mean difference is never significant
  double one_seed = 0;    // one seed: a smaller difference may be chance
  double with_noise = 0;  // the same if the baseline was trained twice; the difference of its two runs may raise it
};

/// Shares of the baseline's time. Runs in turns on one machine usually differ by 1 to 3 %. With one seed, the
/// difference of two such runs has a standard deviation of up to 3 % x sqrt(2), so that chance exceeds 10 % in at most
/// 2 of 100 comparisons. The turns may show that they differ by more.
inline constexpr Measure kTime{0.01, 0.1, 0.01};
/// 0.1 dB is 2.3 % of the squared error, and docs/recipes.md trusts no smaller effect. With one seed, trainings with
/// the same options have differed by 1 dB on `fox`. Two runs of the baseline may agree to the last bit although other
/// options round differently, so the limits for one seed do not change.
inline constexpr Measure kPsnr{0.1, 1, 1}, kSsim{0.003, 0.03, 0.03};
inline constexpr Measure kCount{0.02, 0.2, 0.2};  // shares of the baseline's number of Gaussians

/// Training times of two configurations in the same turns, s. Several seeds follow one after the other.
struct TurnTimes {
  std::vector<double> before_s, after_s;

  /// Returns whether there are too few turns, or too short ones, to judge times.
  bool are_too_short() const;
  /// Returns the 95 % margin of the share of time saved over all turns, from the spread of the differences between the
  /// turns of a pair.
  double margin() const;
};

struct EffectLimits {
  double floor = 0, one_seed = 0;
  double margin = 0;          // minimum margin of the mean difference, whatever the spread over seeds
  bool is_too_short = false;  // no judgement is possible
};

/// Returns the limits of a measure. `noise` is the difference between two runs of the baseline, if it was trained
/// twice. Another pair of equal runs differs by more than t(1) = 12.7 x `noise` in 5 of 100 comparisons.
EffectLimits limits_of(const Measure& measure, const std::optional<double>& noise);

/// Returns {"mean", "min", "max", "n"}; null without values.
nlohmann::ordered_json spread_of(const std::vector<double>& values);

/// Returns a spread with "interval", "limit" and "finding" (compare_summary.h); null without values.
nlohmann::ordered_json effect_of(const std::vector<double>& differences, const EffectLimits& limits);

}  // namespace b3dgs
