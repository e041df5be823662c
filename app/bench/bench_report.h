// Results of benchmarks: timings, differences between kernels, and their tables and JSON.
#pragma once

#include <torch/types.h>

#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <utility>
#include <vector>

namespace b3dgs {

struct Timing {
  double median_ms = 0, min_ms = 0, max_ms = 0;
};

/// Returns median and range of the times of single runs; `ms` must not be empty.
Timing summarize(std::vector<double> ms);

/// Returns {"median_ms": 2, "min_ms": 1, "max_ms": 3}, after `head`.
nlohmann::ordered_json to_json(const Timing& timing, nlohmann::ordered_json head = nlohmann::ordered_json::object());

/// Prints a table row without its end: name, median, minimum and maximum.
void print_timing(const std::string& name, const Timing& timing);

/// Returns number of tiles, number of pairs, and load_statistics() of the lengths of the tiles' lists, int64 on the
/// CPU.
nlohmann::ordered_json list_statistics(const torch::Tensor& lengths);

/// Returns the largest difference divided by the largest magnitude in `reference` or by `size`, whichever is larger; 0
/// if there is no difference.
double relative_difference(const torch::Tensor& values, const torch::Tensor& reference, double size = 0);

/// A new JSON file of results. It is rewritten with every result, so that an interrupted benchmark keeps its results.
/// Does nothing without a path.
class BenchFile {
 public:
  /// @throws InputError if `path` exists
  explicit BenchFile(std::string path);

  /// @throws IoError
  void set(const std::string& key, nlohmann::ordered_json value);

 private:
  std::string path_;
  nlohmann::ordered_json figures_ = nlohmann::ordered_json::object();
};

struct ParameterGradient {
  torch::Tensor values;
  double size = 0;  // lower limit of the magnitude in relative_difference()
};

/// Timing and results of one kernel, on the CPU.
struct Measurement {
  std::string name;
  Timing timing;
  torch::Tensor image{};                       // compared by absolute difference; may be undefined
  std::vector<ParameterGradient> gradients{};  // compared by relative_difference()
  std::optional<Timing> keeping{};             // forward kernels: when also storing data for the backward pass
};

/// A table of kernels for one pass. Each is compared with the first, so all must measure the same quantities.
class ComparisonTable {
 public:
  explicit ComparisonTable(std::string title) : title_(std::move(title)) {}

  /// Prints the row. Prints a header for the measured quantities before the first row.
  void add(const Measurement& measurement);

  const nlohmann::ordered_json& rows() const { return rows_; }

 private:
  std::string title_;
  std::optional<Measurement> first_;
  nlohmann::ordered_json rows_ = nlohmann::ordered_json::array();
};

}  // namespace b3dgs
