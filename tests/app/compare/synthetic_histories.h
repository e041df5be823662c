// Synthetic training histories for tests of comparisons.
#pragma once

#include <string>
#include <utility>
#include <vector>

#include "app/compare/compare_summary.h"
#include "app/compare/compare_verdict.h"
#include "core/text.h"

namespace b3dgs::test {

/// Returns lines every 10 iterations: `early_ms` per step up to iteration 2000, `late_ms` after it. No kernel is named.
inline TrainHistory history(double early_ms, double late_ms, int until = 4000) {
  TrainHistory history;
  double elapsed_s = 0;
  for (int iteration = 10; iteration <= until; iteration += 10) {
    elapsed_s += 0.01 * (iteration <= 2000 ? early_ms : late_ms);
    LogPoint point;
    point.iteration = iteration;
    point.elapsed_s = elapsed_s;
    history.points.push_back(point);
  }
  return history;
}

/// Sets the same kernel in all lines.
inline TrainHistory with_kernel(TrainHistory history, const std::string& kernel) {
  for (LogPoint& point : history.points) point.kernel = kernel;
  return history;
}

/// Returns the event of a timing check.
inline nlohmann::ordered_json check(int iteration, const std::string& in_use, const std::string& other, bool switches) {
  return {{"iteration", iteration},
          {"views", 8},
          {"times_ms", {{in_use, 2.0}, {other, switches ? 1.0 : 3.0}}},
          {"error_ms", 0.125},
          {"cost_ms", nullptr},
          {"before", in_use},
          {"after", switches ? other : in_use},
          {"reason", other + (switches ? " takes less" : " takes more")}};
}

/// Adds a switch between two kernels before the step of `iteration`.
inline TrainHistory with_switch(TrainHistory history, int iteration, const std::string& from = "segmented",
                                const std::string& to = "sub-tile") {
  for (LogPoint& point : history.points) point.kernel = point.iteration < iteration ? from : to;
  nlohmann::ordered_json& checks = history.events["kernel_check"];
  if (iteration > 1000) checks.push_back(check(iteration - 1000, from, to, false));
  checks.push_back(check(iteration, from, to, true));
  return history;
}

inline TrainHistory with_quality(TrainHistory history, double psnr, std::int64_t count) {
  history.points.back().test_psnr = psnr;
  history.points.back().test_ssim = 0.9;
  history.points.back().count = count;
  return history;
}

inline TrainConfig config_with(const std::string& kernel) {
  TrainConfig config;
  config.kernel = kernel;
  return config;
}

/// Returns a configuration named after its kernel.
inline ConfigurationHistory trained(const std::string& kernel, std::vector<TrainHistory> by_seed) {
  return {kernel, config_with(kernel), std::move(by_seed)};
}

inline nlohmann::ordered_json summarize_pair(std::vector<TrainHistory> naive, std::vector<TrainHistory> ours,
                                             const std::string& kernel = "adaptive") {
  return summarize_comparison({trained("naive", std::move(naive)), {"ours", config_with(kernel), std::move(ours)}},
                              4000, 100);
}

/// Returns the cells of the row with this name, separated by " | ", or "" if there is none.
inline std::string row_of(const TextTable& table, const std::string& name) {
  for (const std::vector<std::string>& row : table) {
    if (row.front() == name) return list_text(row, " | ");
  }
  return "";
}

}  // namespace b3dgs::test
