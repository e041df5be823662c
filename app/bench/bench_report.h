// Figures of a benchmark: medians with their spread, differences, and the tables and JSON they go into.
#pragma once

#include <cstdint>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "raster/cuda/kernel_resources.h"

namespace b3dgs {

struct Timing {
  double median_ms = 0, min_ms = 0, max_ms = 0;
};

/// Median and range of single runs; `ms` is not empty.
Timing summarize(std::vector<double> ms);

nlohmann::ordered_json to_json(const Timing& timing);

/// Lengths of the tiles' lists, which are what balancing has to even out: how many, their sum, and load_statistics().
/// `lengths` is not empty.
nlohmann::ordered_json list_statistics(const std::vector<std::int64_t>& lengths);
void print_list_statistics(const nlohmann::ordered_json& statistics);

/// Largest |a - b|; infinite if one of the values is not a number.
double largest_difference(const std::vector<float>& a, const std::vector<float>& b);

/// Largest difference over the largest magnitude of `reference`, or over `size` if that is more; 0 if both hold nothing
/// but zeros.
double relative_difference(const std::vector<float>& values, const std::vector<float>& reference, double size = 0);

/// What a benchmark has found so far: printed by whoever finds it, and in a file, renewed with every figure, if there
/// is a path. Who ends a long benchmark keeps both.
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
  double size = 0;  // at least, for differences relative to it
};

/// What one alternative for a pass did.
struct Measurement {
  std::string name;
  Timing timing;
  std::vector<float> image;                          // compared as it is
  std::vector<NamedArray> gradients;                 // one a parameter, each compared relative to its largest value
  std::optional<cuda::KernelResources> resources{};  // of CUDA kernels
  std::optional<Timing> keeping{};                   // of a forward kernel that keeps what its backward pass needs
};

/// What is shown of the rows besides their times; what is not shown need not be measured.
struct ComparisonColumns {
  bool image = true;
  bool gradients = false;
  bool resources = false;
  bool keeping = false;
};

/// Rows of alternatives for one pass, compared with the first of them.
class ComparisonTable {
 public:
  /// Prints the head of the table.
  ComparisonTable(const std::string& title, const ComparisonColumns& columns);

  /// Prints the row.
  void add(Measurement measurement);

  const nlohmann::ordered_json& rows() const { return rows_; }

 private:
  ComparisonColumns columns_;
  std::optional<Measurement> first_;
  nlohmann::ordered_json rows_ = nlohmann::ordered_json::array();
};

/// Rows of passes that follow one another, with their sum.
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
