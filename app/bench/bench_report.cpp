#include "app/bench/bench_report.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <numeric>

#include "adaptive/load_statistics.h"
#include "core/check.h"
#include "core/files/atomic_file.h"

namespace b3dgs {
namespace {

/// The largest relative difference of all gradients.
double gradient_difference(const Measurement& measurement, const Measurement& first) {
  double largest = 0;
  for (std::size_t i = 0; i < first.gradients.size(); ++i) {
    const ParameterGradient& reference = first.gradients[i];
    largest =
        std::max(largest, relative_difference(measurement.gradients.at(i).values, reference.values, reference.size));
  }
  return largest;
}

}  // namespace

Timing summarize(std::vector<double> ms) {
  std::sort(ms.begin(), ms.end());
  return {ms[ms.size() / 2], ms.front(), ms.back()};
}

nlohmann::ordered_json to_json(const Timing& timing, nlohmann::ordered_json head) {
  head.update({{"median_ms", timing.median_ms}, {"min_ms", timing.min_ms}, {"max_ms", timing.max_ms}});
  return head;
}

void print_timing(const std::string& name, const Timing& timing) {
  std::printf("%-16s %10.3f %10.3f .. %9.3f", name.c_str(), timing.median_ms, timing.min_ms, timing.max_ms);
}

nlohmann::ordered_json list_statistics(const std::vector<std::int64_t>& lengths) {
  nlohmann::ordered_json statistics{{"tiles", lengths.size()},
                                    {"pairs", std::accumulate(lengths.begin(), lengths.end(), std::int64_t{0})}};
  statistics.update(to_json(load_statistics(lengths.data(), static_cast<std::int64_t>(lengths.size()))));
  return statistics;
}

void print_list_statistics(const nlohmann::ordered_json& statistics) {
  std::printf(
      "Gaussians per tile: mean %.0f, median %lld, 90th percentile %lld, 99th percentile %lld, maximum %lld, Gini "
      "coefficient %.2f; %lld (tile, splat) pairs\n",
      statistics["mean"].get<double>(), statistics["median"].get<long long>(), statistics["p90"].get<long long>(),
      statistics["p99"].get<long long>(), statistics["max"].get<long long>(), statistics["gini"].get<double>(),
      statistics["pairs"].get<long long>());
}

double largest_difference(const std::vector<float>& a, const std::vector<float>& b) {
  B3DGS_CHECK(a.size() == b.size(), "cannot compare arrays of ", a.size(), " and ", b.size(), " values");
  double largest = 0;
  for (std::size_t i = 0; i < a.size(); ++i) {
    const double difference = std::fabs(double{a[i]} - double{b[i]});
    if (!(difference <= largest)) largest = std::isnan(difference) ? HUGE_VAL : difference;
  }
  return largest;
}

double relative_difference(const std::vector<float>& values, const std::vector<float>& reference, double size) {
  double magnitude = size;
  for (const float value : reference) magnitude = std::max(magnitude, std::fabs(double{value}));
  const double difference = largest_difference(values, reference);
  return difference > 0 ? difference / magnitude : 0.0;
}

void check_new_json(const std::string& path) {
  std::error_code error;  // writing reports it
  if (!path.empty() && std::filesystem::exists(std::filesystem::symlink_status(path, error))) {
    input_error("--json: ", path, " exists; name another file, or remove it");
  }
}

void BenchFile::set(const std::string& key, nlohmann::ordered_json value) {
  figures_[key] = std::move(value);
  if (!path_.empty()) write_file(path_, figures_.dump(2) + "\n");
}

void ComparisonTable::print_header() const {
  const bool has_image = !first_->image.empty(), has_gradients = !first_->gradients.empty();
  std::printf("\nspeedup%s: relative to the first row%s\n",
              has_image || has_gradients ? " and largest differences of image and gradients" : "",
              first_->keeping ? "; training: median ms when the kernel also stores data for the backward pass" : "");
  std::printf("%-16s %10s %23s %9s", title_.c_str(), "median ms", "min .. max", "speedup");
  if (first_->keeping) std::printf(" %10s", "training");
  if (has_image) std::printf(" %11s", "image diff.");
  if (has_gradients) std::printf(" %11s", "grad. diff.");
  std::printf("\n");
}

void ComparisonTable::add(const Measurement& measurement) {
  if (!first_) {
    first_ = measurement;
    print_header();
  }
  const double speedup = first_->timing.median_ms / measurement.timing.median_ms;
  nlohmann::ordered_json row = to_json(measurement.timing, {{"kernel", measurement.name}});
  row["speedup"] = speedup;
  print_timing(measurement.name, measurement.timing);
  std::printf(" %9.2f", speedup);
  if (measurement.keeping) {
    std::printf(" %10.3f", measurement.keeping->median_ms);
    row["keeping"] = to_json(*measurement.keeping);
  }
  if (!first_->image.empty()) {
    const double difference = largest_difference(measurement.image, first_->image);
    std::printf(" %11.1e", difference);
    row["image_difference"] = difference;
  }
  if (!first_->gradients.empty()) {
    const double difference = gradient_difference(measurement, *first_);
    std::printf(" %11.1e", difference);
    row["gradient_difference"] = difference;
  }
  std::printf("\n");
  rows_.push_back(row);
}

}  // namespace b3dgs
