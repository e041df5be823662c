// Summary of a distribution of counts, such as Gaussians per tile. It shows how evenly work is distributed.
#pragma once

#include <cstdint>
#include <nlohmann/json.hpp>
#include <vector>

namespace b3dgs {

/// Statistics of n non-negative counts. If n is 0, all are zero and there are no bins. Quantile q is the value at index
/// floor(q (n - 1)) of the sorted counts.
struct LoadStatistics {
  std::int64_t n = 0;
  std::int64_t min = 0, median = 0, p90 = 0, p99 = 0, max = 0;
  double mean = 0;
  double gini = 0;  // Gini coefficient, 0: all counts are equal; close to 1: one has nearly everything
  std::vector<std::int64_t> log2_bins;  // bin 0: zeros; bin k: counts in [2^(k-1), 2^k); ends with the bin of max
};

/// Summarises n counts, not negative. Needs 8 bytes for each count up to the largest. Count is int32_t or int64_t.
template <class Count>
LoadStatistics load_statistics(const Count* values, std::int64_t n);

/// Calls field(name, member) for each member of LoadStatistics except n, with its name in train.jsonl and compare.json.
template <class Load, class Field>
void visit_load_figures(Load& load, Field&& field) {
  field("min", load.min);
  field("median", load.median);
  field("p90", load.p90);
  field("p99", load.p99);
  field("max", load.max);
  field("mean", load.mean);
  field("gini", load.gini);
  field("log2_bins", load.log2_bins);
}

/// Returns an object with the names of visit_load_figures() as keys.
nlohmann::ordered_json to_json(const LoadStatistics& statistics);

}  // namespace b3dgs
