// Results of benchmarks: timings, differences between kernels, and the tables and JSON that show them.
#pragma once

#include <cstdint>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "raster/cuda/gpu_support.h"

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

/// Number of tiles, number of pairs, and load_statistics() of the lengths of the tiles' lists. `lengths` must not be
/// empty.
nlohmann::ordered_json list_statistics(const std::vector<std::int64_t>& lengths);
void print_list_statistics(const nlohmann::ordered_json& statistics);

/// Largest |a - b|; infinite if a value is NaN.
double largest_difference(const std::vector<float>& a, const std::vector<float>& b);

/// Largest difference divided by the largest magnitude in `reference` or by `size`, whichever is larger; 0 if there is
/// no difference.
double relative_difference(const std::vector<float>& values, const std::vector<float>& reference, double size = 0);

/// Results so far as a JSON file, which is rewritten with every result: a benchmark that is interrupted keeps them.
/// Does nothing without a path.
class BenchFile {
 public:
  explicit BenchFile(std::string path) : path_(std::move(path)) {}

  /// @throws IoError
  void set(const std::string& key, nlohmann::ordered_json value);

 private:
  std::string path_;
  nlohmann::ordered_json figures_ = nlohmann::ordered_json::object();
};

struct NamedArray {
  std::string name;
  std::vector<float> values;
  double size = 0;  // lower limit of the magnitude in relative_difference()
};

/// Timing and results of one kernel.
struct Measurement {
  std::string name;
  Timing timing;
  std::vector<float> image;                          // compared by absolute difference
  std::vector<NamedArray> gradients;                 // one per parameter, compared by relative_difference()
  std::optional<cuda::KernelResources> resources{};  // of CUDA kernels
  std::optional<Timing> keeping{};                   // forward kernels: when also storing data for the backward pass
};

/// Columns besides the times. What is not shown need not be measured.
struct ComparisonColumns {
  bool image = true;
  bool gradients = false;
  bool resources = false;
  bool keeping = false;
};

/// A table of kernels for one pass, each compared with the first.
class ComparisonTable {
 public:
  /// Prints the header.
  ComparisonTable(const std::string& title, const ComparisonColumns& columns);

  /// Prints the row.
  void add(Measurement measurement);

  const nlohmann::ordered_json& rows() const { return rows_; }

 private:
  ComparisonColumns columns_;
  std::optional<Measurement> first_;
  nlohmann::ordered_json rows_ = nlohmann::ordered_json::array();
};

/// A table of consecutive passes with the sum of their times.
class PassTable {
 public:
  explicit PassTable(const std::string& title);
  void add(const std::string& name, const Timing& timing);
  void print_sum(const std::string& name) const;
  const nlohmann::ordered_json& rows() const { return rows_; }

 private:
  double sum_ms_ = 0;
  nlohmann::ordered_json rows_ = nlohmann::ordered_json::array();
};

}  // namespace b3dgs
