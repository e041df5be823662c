// Results of benchmarks: timings, differences between kernels, and the tables and JSON that show them.
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

/// Median and range of the times of single runs; `ms` must not be empty.
Timing summarize(std::vector<double> ms);

/// {"median_ms": 2, "min_ms": 1, "max_ms": 3}, after `head`.
nlohmann::ordered_json to_json(const Timing& timing, nlohmann::ordered_json head = nlohmann::ordered_json::object());

/// A row of a table, without its end: name, median, minimum and maximum.
void print_timing(const std::string& name, const Timing& timing);

/// Number of tiles, number of pairs, and load_statistics() of the lengths of the tiles' lists, int64 on the CPU.
nlohmann::ordered_json list_statistics(const torch::Tensor& lengths);

/// Largest difference divided by the largest magnitude in `reference` or by `size`, whichever is larger; 0 if there is
/// no difference.
double relative_difference(const torch::Tensor& values, const torch::Tensor& reference, double size = 0);

/// Results so far as a new JSON file, which is rewritten with every result: a benchmark that is interrupted keeps them.
/// Does nothing without a path.
class BenchFile {
 public:
  /// @throws InputError if there is something at `path`
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

/// A table of kernels for one pass, each compared with the first, of which the same must have been measured.
class ComparisonTable {
 public:
  explicit ComparisonTable(std::string title) : title_(std::move(title)) {}

  /// Prints the row; before the first one a header, for what was measured.
  void add(const Measurement& measurement);

  const nlohmann::ordered_json& rows() const { return rows_; }

 private:
  std::string title_;
  std::optional<Measurement> first_;
  nlohmann::ordered_json rows_ = nlohmann::ordered_json::array();
};

}  // namespace b3dgs
