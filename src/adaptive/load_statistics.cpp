#include "adaptive/load_statistics.h"

#include <algorithm>
#include <utility>

#include "core/check.h"

namespace b3dgs {
namespace {

std::size_t log2_bin(std::int64_t value) {
  std::size_t bin = 0;
  for (; value > 0; value >>= 1) ++bin;
  return bin;
}

}  // namespace

template <class Count>
LoadStatistics load_statistics(const Count* values, std::int64_t n) {
  LoadStatistics statistics;
  statistics.n = n;
  if (n == 0) return statistics;
  const auto [least, most] = std::minmax_element(values, values + n);
  B3DGS_CHECK(*least >= 0, "load statistics: negative count ", *least);
  statistics.min = *least;
  statistics.max = *most;
  std::vector<std::int64_t> occurrences(static_cast<std::size_t>(*most) + 1);
  for (std::int64_t i = 0; i < n; ++i) ++occurrences[static_cast<std::size_t>(values[i])];
  statistics.log2_bins.resize(log2_bin(statistics.max) + 1);

  const std::pair<double, std::int64_t*> quantiles[] = {
      {0.5, &statistics.median}, {0.9, &statistics.p90}, {0.99, &statistics.p99}};
  std::int64_t before = 0;         // number of values smaller than the current one
  double total = 0, weighted = 0;  // sum of the values; sum of rank (from 1, ascending) times value
  for (std::int64_t value = *least; value <= *most; ++value) {
    const std::int64_t count = occurrences[static_cast<std::size_t>(value)];
    if (count == 0) continue;
    for (const auto& [share, quantile] : quantiles) {
      const auto place = static_cast<std::int64_t>(share * static_cast<double>(n - 1));
      if (place >= before && place < before + count) *quantile = value;
    }
    statistics.log2_bins[log2_bin(value)] += count;
    const auto v = static_cast<double>(value), c = static_cast<double>(count), b = static_cast<double>(before);
    total += v * c;
    weighted += v * c * (b + 0.5 * (c + 1));
    before += count;
  }
  const auto size = static_cast<double>(n);
  statistics.mean = total / size;
  if (total > 0) statistics.gini = 2 * weighted / (size * total) - (size + 1) / size;
  return statistics;
}

template LoadStatistics load_statistics(const std::int32_t* values, std::int64_t n);
template LoadStatistics load_statistics(const std::int64_t* values, std::int64_t n);

nlohmann::ordered_json to_json(const LoadStatistics& statistics) {
  nlohmann::ordered_json json;
  visit_load_figures(statistics, [&](const char* name, const auto& value) { json[name] = value; });
  return json;
}

}  // namespace b3dgs
