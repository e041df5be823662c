#include "app/compare/chance.h"

#include <algorithm>
#include <cmath>
#include <iterator>
#include <numeric>

namespace b3dgs {
namespace {

/// 97.5 % quantiles of Student's t distribution for 1, 2, ... degrees of freedom.
constexpr double kStudentT[] = {12.706, 4.303, 3.182, 2.776, 2.571, 2.447, 2.365, 2.306, 2.262, 2.228,
                                2.201,  2.179, 2.160, 2.145, 2.131, 2.120, 2.110, 2.101, 2.093, 2.086,
                                2.080,  2.074, 2.069, 2.064, 2.060, 2.056, 2.052, 2.048, 2.045, 2.042};

/// Returns the quantile. Beyond the table this is its last value, which is at most 4 % too large.
double student_t(std::size_t degrees_of_freedom) {
  return kStudentT[std::min(degrees_of_freedom, std::size(kStudentT)) - 1];
}

/// With fewer blocks of turns, a spread cannot be estimated.
constexpr std::size_t kFewestBlocks = 5;
constexpr std::size_t kFewestTurns = 2 * kFewestBlocks;  // enough to detect whether neighbours depend on each other
/// Shorter trainings mostly measure the warm-up of caches and clocks.
constexpr double kShortestS = 10;

/// With one seed, a difference below this share of the floor is called equal. If the true difference were the floor or
/// more, such a small difference would occur in at most 2.4 % of comparisons, however much (normally distributed) runs
/// vary.
constexpr double kEqualShare = 1.0 / 20;

double sum(const std::vector<double>& values) {
  return std::accumulate(values.begin(), values.end(), 0.0);
}

const char* finding_of(double mean, double margin, double limit) {
  if (mean - margin >= -limit && mean + margin <= limit) return "equal";
  return std::fabs(mean) > margin && std::fabs(mean) >= limit ? "differs" : "unclear";
}

}  // namespace

bool TurnTimes::are_too_short() const {
  return before_s.size() < kFewestTurns || sum(before_s) < kShortestS || sum(after_s) < kShortestS;
}

double TurnTimes::margin() const {
  const std::size_t n = before_s.size();
  const double total_s = sum(before_s), saved = (total_s - sum(after_s)) / total_s;
  double margin = 0;
  // Turns take longer as Gaussians are added, so each is compared with its share of the whole saving. A load that lasts
  // for several turns makes their differences depend on each other. Sums of neighbours reveal this, so the largest
  // margin of all block lengths is used.
  for (std::size_t n_blocks = n; n_blocks >= kFewestBlocks; n_blocks /= 2) {
    std::vector<double> blocks(n_blocks);
    for (std::size_t i = 0; i < n; ++i) blocks[i * n_blocks / n] += before_s[i] * (1 - saved) - after_s[i];
    const double squares = std::inner_product(blocks.begin(), blocks.end(), blocks.begin(), 0.0);
    const auto degrees = static_cast<double>(n_blocks - 1);
    const double standard_error = std::sqrt(squares * static_cast<double>(n_blocks) / degrees) / total_s;
    margin = std::max(margin, student_t(n_blocks - 1) * standard_error);
  }
  return margin;
}

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
    const double limit = std::max(limits.one_seed, limits.margin);
    const bool is_equal = std::fabs(mean) < kEqualShare * limits.floor;
    effect.update({{"interval", nullptr},
                   {"limit", limit},
                   {"finding", is_equal                  ? "equal"
                               : std::fabs(mean) > limit ? "differs"
                                                         : "unclear"}});
  } else {
    double squares = 0;
    for (const double own : differences) squares += (own - mean) * (own - mean);
    const double standard_error = std::sqrt(squares / static_cast<double>(n - 1) / static_cast<double>(n));
    const double margin = std::max(student_t(n - 1) * standard_error, limits.margin);
    effect.update({{"interval", {mean - margin, mean + margin}},
                   {"limit", limits.floor},
                   {"finding", finding_of(mean, margin, limits.floor)}});
  }
  if (limits.is_too_short) effect["finding"] = "too short";
  return effect;
}

}  // namespace b3dgs
