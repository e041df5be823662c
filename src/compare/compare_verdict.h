// A comparison in sentences: the report's first line, and the words that tables share with it.
#pragma once

#include <optional>
#include <string>

#include "compare/compare_summary.h"

namespace b3dgs {

/// Less than this share saved or lost is called no difference.
inline constexpr double kNoDifference = 0.01;

/// Did it pay? Balancing is credited with the step from the best unbalanced kernel alone, and only among configurations
/// that differ in nothing but forward kernels; else it is the configuration that did it, and its options are named.
std::string verdict(const ComparisonSummary& summary);

/// "18.3 %"
std::string format_percent(double share);
/// "18 %"
std::string format_whole_percent(double share);

/// " +-0.4 %", or "" if the machine's spread was not measured.
std::string format_noise(const std::optional<double>& share);

/// "naive to shared-memory 53.3 %, shared-memory to adaptive (balancing) 31.8 %, naive to adaptive 68.2 %", each with
/// the machine's spread if that was measured.
std::string describe(const BalancingGain& steps, const std::optional<double>& noise);

/// What a configuration that was trained twice says of the machine: of its time and of each figure of quality.
std::string describe_repetition(const ComparisonSummary& summary);

/// "+0.05" of a measure of quality, with as many digits as it has everywhere; without a sign if `is_distance`.
std::string format_quality_difference(const std::string& measure, double difference, bool is_distance = false);

/// " in 1 of 3 seeds", or "" if it is all of them.
std::string in_seeds(int n, int of);

}  // namespace b3dgs
