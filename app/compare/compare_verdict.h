// The result of a comparison in one sentence and in tables. The terminal and the report show the same texts.
#pragma once

#include <nlohmann/json.hpp>
#include <string>
#include <vector>

namespace b3dgs {

/// Returns the headline: the time that the configuration summary["ours"] saved against the baseline, with its 95 %
/// interval or the assumptions of one seed, and whether its PSNR differs.
std::string verdict(const nlohmann::ordered_json& summary);

/// Rows of texts. The first row is the head, and the first text of each row names it. "-" stands for no value.
using TextTable = std::vector<std::vector<std::string>>;

/// The head of a column in tables with findings on one seed: smaller differences may be chance.
inline constexpr const char* kOneSeedLimit = "one-seed limit";

/// Returns the times and results of each configuration, and its differences from the baseline.
TextTable results_table(const nlohmann::ordered_json& summary);

/// Returns the time that load balancing alone saved, for each configuration for which it is known. Otherwise empty.
TextTable balancing_table(const nlohmann::ordered_json& summary);

/// Returns the time saved up to the inflection, from it and overall, for each pair of configurations that repeats the
/// comparison of the Balanced 3DGS paper, above the paper's own results. Empty if there is no such pair.
TextTable paper_table(const nlohmann::ordered_json& summary);

/// Aligns the columns of a table, the first to the left.
std::string aligned_text(const TextTable& table);

}  // namespace b3dgs
