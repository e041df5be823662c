#include "app/bench_report.h"

#include <algorithm>
#include <cmath>
#include <cstdio>

namespace b3dgs {
namespace {

nlohmann::ordered_json to_row(const char* kind, const std::string& name, const Timing& timing) {
  return {{kind, name}, {"median_ms", timing.median_ms}, {"min_ms", timing.min_ms}, {"max_ms", timing.max_ms}};
}

}  // namespace

Timing summarize(std::vector<double> ms) {
  std::sort(ms.begin(), ms.end());
  return {ms[ms.size() / 2], ms.front(), ms.back()};
}

nlohmann::ordered_json list_statistics(std::vector<long long> lengths) {
  std::sort(lengths.begin(), lengths.end());
  const auto n = static_cast<double>(lengths.size());
  double total = 0, ranked = 0;
  for (std::size_t i = 0; i < lengths.size(); ++i) {
    total += static_cast<double>(lengths[i]);
    ranked += static_cast<double>(i + 1) * static_cast<double>(lengths[i]);
  }
  const auto at = [&](double share) { return lengths[static_cast<std::size_t>(share * (n - 1))]; };
  return {{"tiles", lengths.size()}, {"pairs", static_cast<long long>(total)},
          {"mean", total / n},       {"median", at(0.5)},
          {"p90", at(0.9)},          {"p99", at(0.99)},
          {"max", lengths.back()},   {"gini", total > 0 ? 2 * ranked / (n * total) - (n + 1) / n : 0.0}};
}

void print_list_statistics(const nlohmann::ordered_json& statistics) {
  std::printf("list lengths: mean %.0f, median %lld, p90 %lld, p99 %lld, max %lld, Gini %.2f; %lld pairs\n",
              statistics["mean"].get<double>(), statistics["median"].get<long long>(),
              statistics["p90"].get<long long>(), statistics["p99"].get<long long>(),
              statistics["max"].get<long long>(), statistics["gini"].get<double>(),
              statistics["pairs"].get<long long>());
}

double largest_difference(const std::vector<float>& a, const std::vector<float>& b) {
  double largest = 0;
  for (std::size_t i = 0; i < a.size(); ++i) largest = std::max(largest, std::fabs(double{a[i]} - double{b[i]}));
  return largest;
}

ComparisonTable::ComparisonTable(const std::string& title) {
  std::printf("\n%-16s %10s %23s %9s %12s\n", title.c_str(), "median ms", "min .. max", "x first", "difference");
}

void ComparisonTable::add(const std::string& name, const Timing& timing, const std::vector<float>& output) {
  if (first_output_.empty()) {
    first_output_ = output;
    first_ms_ = timing.median_ms;
  }
  const double difference = largest_difference(output, first_output_), speedup = first_ms_ / timing.median_ms;
  std::printf("%-16s %10.3f %10.3f .. %9.3f %9.2f %12.1e\n", name.c_str(), timing.median_ms, timing.min_ms,
              timing.max_ms, speedup, difference);
  nlohmann::ordered_json row = to_row("kernel", name, timing);
  row["speedup"] = speedup;
  row["largest_difference"] = difference;
  rows_.push_back(row);
}

PassTable::PassTable(const std::string& title) {
  std::printf("\n%-16s %10s %23s\n", title.c_str(), "median ms", "min .. max");
}

void PassTable::add(const std::string& name, const Timing& timing) {
  std::printf("%-16s %10.3f %10.3f .. %9.3f\n", name.c_str(), timing.median_ms, timing.min_ms, timing.max_ms);
  rows_.push_back(to_row("pass", name, timing));
  sum_ms_ += timing.median_ms;
}

void PassTable::print_sum(const std::string& name) const {
  std::printf("%-16s %10.3f\n", name.c_str(), sum_ms_);
}

}  // namespace b3dgs
