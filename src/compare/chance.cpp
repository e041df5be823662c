#include "compare/chance.h"

#include <algorithm>
#include <cmath>
#include <iterator>

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

const char* finding_of(double mean, double margin, double limit) {
  if (mean - margin >= -limit && mean + margin <= limit) return "equal";
  return std::fabs(mean) > margin && std::fabs(mean) >= limit ? "differs" : "unclear";
}

}  // namespace

EffectLimits limits_of(const Measure& measure, const std::optional<double>& noise) {
  if (!noise) return {measure.floor, measure.one_seed};
  return {measure.floor, std::max(measure.with_noise, student_t(1) * *noise)};
}

nlohmann::ordered_json spread_of(const std::vector<double>& values) {
  if (values.empty()) return nullptr;
  double mean = 0;
  for (const double value : values) mean += value / static_cast<double>(values.size());
  const auto [min, max] = std::minmax_element(values.begin(), values.end());
  return {{"mean", mean}, {"min", *min}, {"max", *max}, {"n", values.size()}};
}

nlohmann::ordered_json effect_of(const std::vector<double>& differences, const EffectLimits& limits) {
  nlohmann::ordered_json effect = spread_of(differences);
  if (effect.is_null()) return effect;
  const std::size_t n = differences.size();
  const double mean = effect["mean"];
  if (n == 1) {
    const bool differs = std::fabs(mean) > limits.one_seed;
    effect.update({{"interval", nullptr}, {"limit", limits.one_seed}, {"finding", differs ? "differs" : "unclear"}});
    return effect;
  }
  double squares = 0;
  for (const double own : differences) squares += (own - mean) * (own - mean);
  const double standard_error = std::sqrt(squares / static_cast<double>(n - 1) / static_cast<double>(n));
  const double margin = student_t(n - 1) * standard_error;
  effect.update({{"interval", {mean - margin, mean + margin}},
                 {"limit", limits.floor},
                 {"finding", finding_of(mean, margin, limits.floor)}});
  return effect;
}

}  // namespace b3dgs
