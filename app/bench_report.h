// Figures of a benchmark: medians with their spread, differences, and the tables and JSON they go into.
#pragma once

#include <string>
#include <vector>

#include <nlohmann/json.hpp>

namespace b3dgs {

struct Timing {
  double median_ms = 0, min_ms = 0, max_ms = 0;
};

/// Median and range of single runs; `ms` is not empty.
Timing summarize(std::vector<double> ms);

/// Lengths of the tiles' lists, which are what balancing has to even out: mean, median, p90, p99, max, Gini.
nlohmann::ordered_json list_statistics(std::vector<long long> lengths);
void print_list_statistics(const nlohmann::ordered_json& statistics);

double largest_difference(const std::vector<float>& a, const std::vector<float>& b);

/// Rows of alternatives for one pass, compared with the first of them.
class ComparisonTable {
 public:
  /// Prints the head of the table.
  explicit ComparisonTable(const std::string& title);

  /// `output` is what the alternative computed: its largest difference from the first one's is shown.
  void add(const std::string& name, const Timing& timing, const std::vector<float>& output);

  const nlohmann::ordered_json& rows() const { return rows_; }

 private:
  std::vector<float> first_output_;
  double first_ms_ = 0;
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
