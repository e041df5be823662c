// Whether a difference between two configurations is more than chance: paired differences over seeds.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "report/time_saved.h"

namespace b3dgs {

/// What the runs allow to say. kUnclear: the difference may be chance.
enum class Finding { kUnclear, kEqual, kDiffers };

struct EffectLimits {
  double floor = 0;     // several seeds: a smaller mean difference is not called one, however sure it is
  double one_seed = 0;  // one seed: a smaller difference may be chance
};

/// 0.1 dB is 2.3 % of the squared error; docs/recipes.md trusts no smaller effect. With one seed: trainings of the same
/// options have differed by 1 dB on `fox`.
inline constexpr EffectLimits kPsnrLimits{0.1, 1};
/// Runs in turns on one machine differ by 1 to 3 %. With one seed, the difference of two such runs has a standard
/// deviation of up to 3 % x sqrt(2), so that 10 % are exceeded by chance in 2 of 100 comparisons at most.
inline constexpr EffectLimits kTimeLimits{0.01, 0.1};

/// The difference in runs with the same seeds, one value for each seed.
struct Effect : Spread {
  std::optional<double> margin;  // half of the 95 % interval of the mean (Student's t); empty with one seed
  double limit = 0;              // of EffectLimits, the one that applies
  Finding finding = Finding::kUnclear;

  bool differs() const { return finding == Finding::kDiffers; }
  double low() const { return mean - margin.value_or(0); }
  double high() const { return mean + margin.value_or(0); }
};

/// Several seeds: kDiffers if the 95 % interval excludes 0 and the mean is at least the floor, kEqual if the interval
/// lies within the floor on both sides of 0. One seed: kDiffers above the limit, never kEqual. nullopt without values.
std::optional<Effect> effect_of(const std::vector<double>& differences, const EffectLimits& limits);

/// What one seed can say if the baseline was trained twice, with the difference `noise`: it is one difference of
/// equals, which another one exceeds t(1) = 12.7 times in 5 of 100 comparisons.
double limit_with_noise(double noise);

/// The limits for shares of the training time; `noise` is the share by which two runs of the baseline differ.
EffectLimits time_limits(const std::optional<double>& noise);

/// "differs", "equal" or "unclear"; `differs` says it otherwise.
std::string finding_word(const Effect& effect, const std::string& differs = "differs");
/// "faster", "slower", "equal" or "unclear".
std::string time_word(const Effect& saved);

/// "10.1 to 14.9 %", of a share; "" with one seed.
std::string interval_text(const Effect& share);

}  // namespace b3dgs
