// A comparison's summary in words and on the terminal.
#pragma once

#include <nlohmann/json.hpp>
#include <string>

namespace b3dgs {

/// The headline of the report: how much time the configuration summary["ours"] saved against the baseline, what load
/// balancing alone contributed, and PSNR where configurations differ in what they learn. Time is attributed to load
/// balancing only relative to the fastest kernel without it, and only between configurations that differ in nothing but
/// the kernel. Differences that may be chance are not called savings, losses or gains.
std::string verdict(const nlohmann::ordered_json& summary);

/// What was trained, how long that took and what came of it, for standard output.
std::string summary_table(const nlohmann::ordered_json& summary);

/// The time saved up to the inflection, from it and overall, of each pair of configurations that repeats the comparison
/// of the Balanced 3DGS paper, above the paper's own results. "" if there is no such pair.
std::string paper_table(const nlohmann::ordered_json& summary);

}  // namespace b3dgs
