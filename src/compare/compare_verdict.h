// The result of a comparison in sentences, and formatting that tables share with them.
#pragma once

#include <optional>
#include <string>

#include "compare/compare_summary.h"

namespace b3dgs {

/// The headline of the report. Time is attributed to load balancing only relative to the fastest kernel without load
/// balancing, and only between configurations that differ in nothing but the forward kernel; otherwise the
/// configuration is named with the options in which it differs. If configurations differ in what they learn, PSNR is
/// stated as well, or that it was not measured. Differences that may be chance are not called savings, losses or gains.
std::string verdict(const ComparisonSummary& summary);

/// "18.3 %"
std::string format_percent(double share);
/// "18 %"
std::string format_whole_percent(double share);

/// " +-0.4 %", or "" if the run-to-run variation was not measured.
std::string format_noise(const std::optional<double>& share);

/// Explains when times are called different or equal.
std::string time_criterion(const ComparisonSummary& summary);

/// "load balancing saved 31.8 % of the training time of shared-memory; shared-memory saved 53.3 % of the training time
/// of naive; in total adaptive saved 68.2 % of the training time of naive".
std::string describe(const BalancingGain& gain);

/// Run-to-run variation of the baseline: differences in time and quality between its two runs.
std::string describe_repetition(const ComparisonSummary& summary);

/// " in 1 of 3 seeds", or "" if n == of.
std::string in_seeds(int n, int of);

}  // namespace b3dgs
