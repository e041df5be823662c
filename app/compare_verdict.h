// A comparison in sentences: the report's first line, and the words that tables share with it.
#pragma once

#include <string>

#include "app/compare_summary.h"

namespace b3dgs {

/// Less than this share saved or lost is called no difference.
inline constexpr double kNoDifference = 0.01;

/// Did it pay? Balancing is credited only with what was saved while a balanced kernel ran.
std::string verdict(const ComparisonSummary& summary);

/// "18.3 %"
std::string format_percent(double share);
/// "18 %"
std::string format_whole_percent(double share);

/// " in 1 of 3 seeds", or "" if it is all of them.
std::string in_seeds(int n, int of);

}  // namespace b3dgs
