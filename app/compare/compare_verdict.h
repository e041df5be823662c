// A comparison's summary in words and on the terminal.
#pragma once

#include <nlohmann/json.hpp>
#include <string>

namespace b3dgs {

/// Returns the headline of the report: the time that the configuration summary["ours"] saved against the baseline, the
/// contribution of load balancing alone, and PSNR if configurations learn differently. Time is attributed to load
/// balancing only relative to the fastest kernel without it, and only between configurations that differ in nothing but
/// the kernel. Differences that may be chance are not called savings, losses or gains.
std::string verdict(const nlohmann::ordered_json& summary);

/// Returns the trained configurations with their times and results, for standard output.
std::string summary_table(const nlohmann::ordered_json& summary);

/// Returns the time saved up to the inflection, after it and overall, for each pair of configurations that repeats the
/// comparison of the Balanced 3DGS paper, above the paper's own results. Returns "" if there is no such pair.
std::string paper_table(const nlohmann::ordered_json& summary);

}  // namespace b3dgs
