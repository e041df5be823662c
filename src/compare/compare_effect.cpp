#include "compare/compare_effect.h"

#include <algorithm>
#include <cmath>
#include <iterator>

#include "core/print.h"

namespace b3dgs {
namespace {

/// 97.5 % quantiles of Student's t distribution for 1, 2, ... degrees of freedom.
constexpr double kStudentT[] = {12.706, 4.303, 3.182, 2.776, 2.571, 2.447, 2.365, 2.306, 2.262, 2.228,
                                2.201,  2.179, 2.160, 2.145, 2.131, 2.120, 2.110, 2.101, 2.093, 2.086,
                                2.080,  2.074, 2.069, 2.064, 2.060, 2.056, 2.052, 2.048, 2.045, 2.042};

/// Beyond the table its last value, which is at most 4 % too large.
double student_t(std::size_t degrees_of_freedom) {
  return kStudentT[std::min(degrees_of_freedom, std::size(kStudentT)) - 1];
}

Finding finding_of(const Effect& effect) {
  if (!effect.margin) return std::fabs(effect.mean) > effect.limit ? Finding::kDiffers : Finding::kUnclear;
  if (effect.low() >= -effect.limit && effect.high() <= effect.limit) return Finding::kEqual;
  const bool excludes_zero = effect.low() > 0 || effect.high() < 0;
  return excludes_zero && std::fabs(effect.mean) >= effect.limit ? Finding::kDiffers : Finding::kUnclear;
}

}  // namespace

std::optional<Effect> effect_of(const std::vector<double>& differences, const EffectLimits& limits) {
  const std::optional<Spread> spread = spread_of(differences);
  if (!spread) return std::nullopt;
  Effect effect;
  static_cast<Spread&>(effect) = *spread;
  effect.limit = limits.one_seed;
  if (const std::size_t n = differences.size(); n > 1) {
    double squares = 0;
    for (const double own : differences) squares += (own - spread->mean) * (own - spread->mean);
    const double standard_error = std::sqrt(squares / static_cast<double>(n - 1) / static_cast<double>(n));
    effect.margin = student_t(n - 1) * standard_error;
    effect.limit = limits.floor;
  }
  effect.finding = finding_of(effect);
  return effect;
}

double limit_with_noise(double noise) {
  return student_t(1) * noise;
}

EffectLimits time_limits(const std::optional<double>& noise) {
  if (!noise) return kTimeLimits;
  return {kTimeLimits.floor, std::max(kTimeLimits.floor, limit_with_noise(*noise))};
}

std::string finding_word(const Effect& effect, const std::string& differs) {
  return effect.differs() ? differs : effect.finding == Finding::kEqual ? "equal" : "unclear";
}

std::string time_word(const Effect& saved) {
  return finding_word(saved, saved.mean > 0 ? "faster" : "slower");
}

std::string interval_text(const Effect& share) {
  return share.margin ? print_to_string("%.1f to %.1f %%", 100 * share.low(), 100 * share.high()) : "";
}

}  // namespace b3dgs
