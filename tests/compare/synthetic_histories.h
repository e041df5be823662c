// Synthetic training histories for tests of comparisons.
#pragma once

#include <string>
#include <utility>
#include <vector>

#include "compare/compare_summary.h"

namespace b3dgs::test {

/// Lines every 10 iterations: `early_ms` per step up to iteration 2000, `late_ms` after it. No kernel is named.
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

/// With the same forward kernel in all lines.
inline TrainHistory with_kernel(TrainHistory history, const std::string& kernel) {
  for (LogPoint& point : history.points) point.kernel = kernel;
  return history;
}

/// With a switch from combined to shared-memory before the step of `iteration`.
inline TrainHistory with_switch(TrainHistory history, int iteration) {
  for (LogPoint& point : history.points) {
    point.kernel = point.iteration < iteration ? "combined" : "shared-memory";
  }
  KernelCheckEvent kept, changed;
  kept.iteration = iteration - 1000;
  kept.pass = changed.pass = "forward";
  kept.before = kept.after = changed.before = "combined";
  changed.iteration = iteration;
  changed.after = "shared-memory";
  history.checks = {changed};
  if (kept.iteration > 0) history.checks.insert(history.checks.begin(), kept);
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

/// A configuration named after its kernel.
inline ConfigurationHistory trained(const std::string& kernel, std::vector<TrainHistory> by_seed) {
  return {kernel, config_with(kernel), std::move(by_seed)};
}

inline ComparisonSummary summarize_pair(std::vector<TrainHistory> naive, std::vector<TrainHistory> ours,
                                        const std::string& kernel = "adaptive") {
  return summarize_comparison({trained("naive", std::move(naive)), {"ours", config_with(kernel), std::move(ours)}},
                              4000);
}

}  // namespace b3dgs::test
