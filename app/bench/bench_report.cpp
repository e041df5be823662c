#include "app/bench/bench_report.h"

#include <algorithm>
#include <cstdio>
#include <filesystem>

#include "adaptive/load_statistics.h"
#include "core/check.h"
#include "core/files/atomic_file.h"
#include "core/json_text.h"

namespace b3dgs {
namespace {

double largest_difference(const torch::Tensor& a, const torch::Tensor& b) {
  B3DGS_CHECK(a.sizes() == b.sizes(), "cannot compare ", a.sizes(), " and ", b.sizes());
  return a.numel() == 0 ? 0 : (a.to(torch::kFloat64) - b).abs().max().item<double>();
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

nlohmann::ordered_json list_statistics(const torch::Tensor& lengths) {
  const torch::Tensor packed = lengths.contiguous();
  nlohmann::ordered_json statistics{{"tiles", packed.numel()}, {"pairs", packed.sum().item<std::int64_t>()}};
  statistics.update(to_json(load_statistics(packed.data_ptr<std::int64_t>(), packed.numel())));
  return statistics;
}

double relative_difference(const torch::Tensor& values, const torch::Tensor& reference, double size) {
  const double difference = largest_difference(values, reference);
  return difference == 0 ? 0 : difference / std::max(size, reference.abs().max().item<double>());
}

BenchFile::BenchFile(std::string path) : path_(std::move(path)) {
  std::error_code error;  // writing reports it
  if (!path_.empty() && std::filesystem::exists(std::filesystem::symlink_status(path_, error))) {
    input_error("--json: ", path_, " exists; name another file, or remove it");
  }
}

void BenchFile::set(const std::string& key, nlohmann::ordered_json value) {
  figures_[key] = std::move(value);
  if (!path_.empty()) write_file(path_, dump_json(figures_, 2) + "\n");
}

void ComparisonTable::add(const Measurement& measurement) {
  const bool is_first = !first_;
  if (is_first) first_ = measurement;
  const bool has_image = first_->image.defined(), has_gradients = !first_->gradients.empty();
  if (is_first) {
    std::printf("\nspeedup%s: relative to the first row%s\n",
                has_image || has_gradients ? " and largest differences of image and gradients" : "",
                first_->keeping ? "; training: median ms when the kernel also stores data for the backward pass" : "");
    std::printf("%-16s %10s %23s %9s", title_.c_str(), "median ms", "min .. max", "speedup");
    std::printf("%s%s%s\n", first_->keeping ? "   training" : "", has_image ? " image diff." : "",
                has_gradients ? " grad. diff." : "");
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
  const auto add_difference = [&](const char* key, double difference) {
    std::printf(" %11.1e", difference);
    row[key] = difference;
  };
  if (has_image) add_difference("image_difference", largest_difference(measurement.image, first_->image));
  if (has_gradients) {
    double largest = 0;
    for (std::size_t i = 0; i < first_->gradients.size(); ++i) {
      const ParameterGradient& reference = first_->gradients[i];
      const double own = relative_difference(measurement.gradients.at(i).values, reference.values, reference.size);
      if (!(own <= largest)) largest = own;
    }
    add_difference("gradient_difference", largest);
  }
  std::printf("\n");
  rows_.push_back(row);
}

}  // namespace b3dgs
