// How unevenly work is spread: a distribution of counts in a few numbers and a histogram.
#pragma once

#include <cstdint>
#include <nlohmann/json.hpp>
#include <vector>

namespace b3dgs {

/// Of non-negative counts; all zero, without bins, if there were none. A quantile q is the value at place
/// floor(q (n - 1)) of the sorted ones.
struct LoadStatistics {
  std::int64_t n = 0;
  std::int64_t min = 0, median = 0, p90 = 0, p99 = 0, max = 0;
  double mean = 0;
  double gini = 0;                      // 0: all are equal, towards 1: one has it all
  std::vector<std::int64_t> log2_bins;  // bin 0: zeros; bin k: values in [2^(k-1), 2^k); up to that of the maximum
};

/// `values` are at least 0. Count is int32_t or int64_t.
template <class Count>
LoadStatistics load_statistics(const Count* values, std::int64_t n);

/// Calls field(name, member) for each figure, by its name in train.jsonl and compare.json. A Load has the members of
/// LoadStatistics but for n, whatever their types: that is how a reader takes what to_json() wrote.
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

/// An object with those names as keys.
nlohmann::ordered_json to_json(const LoadStatistics& statistics);

}  // namespace b3dgs
