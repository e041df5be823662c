// Summary of the logs of a comparison's runs: time saved, quality, and the contribution of load balancing alone.
#pragma once

#include <nlohmann/json.hpp>
#include <vector>

#include "app/compare/compare_config.h"

namespace b3dgs {

/// The measures of "quality" in compare.json. The verdict uses the first.
inline constexpr const char *kPsnrMeasure = "PSNR, dB", *kSsimMeasure = "SSIM", *kCountMeasure = "Gaussians";

/// Returns "summary" of compare.json, which the page and the terminal show. `configurations`: at least two, starting
/// with the baseline; all have the same seeds. `iterations`: number of iterations requested of the longest. `chunk`:
/// iterations per turn.
///
/// Values over seeds are spreads, {"mean", "min", "max", "n"}, or null without a value. Differences between runs with
/// the same seeds are effects, spreads with
///   "interval": the 95 % interval of the mean (Student's t, over seeds or over turns, whichever is wider), null with
///               one seed
///   "finding": several seeds: "differs" if the interval excludes 0 and the mean is at least "limit", "equal" if the
///              interval lies within the limit on both sides of 0; one seed: "differs" above the limit, "equal" if the
///              values hardly differ; otherwise "unclear": it may be chance. For times, "too short" if there are too
///              few turns, or too short ones, to judge
/// Time saved is a share of the baseline's time, negative if time was lost. "machine_spread" is the difference between
/// two trainings of the baseline, null if it was trained once; "inflection" (the paper's word) is the iteration of the
/// first check that switched to another kernel, and "before" and "after" refer to it.
nlohmann::ordered_json summarize_comparison(const std::vector<ConfigurationHistory>& configurations, int iterations,
                                            int chunk);

/// Returns whether all configurations of a summary train for the same number of iterations.
bool have_equal_lengths(const nlohmann::ordered_json& summary);

}  // namespace b3dgs
