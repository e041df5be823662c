// How much training time one run saved against another, from their logs.
#pragma once

#include <optional>
#include <set>
#include <string>
#include <vector>

#include "config/train_config.h"
#include "report/train_log_reader.h"

namespace b3dgs {

/// All runs of one configuration.
struct ConfigurationHistory {
  std::string name;
  TrainConfig config;
  std::vector<TrainHistory> by_seed;
};

/// Mean and range over seeds.
struct Spread {
  double mean = 0, min = 0, max = 0;
  int n = 0;
  double range() const { return max - min; }
};

/// nullopt if `values` is empty.
std::optional<Spread> spread_of(const std::vector<double>& values);

/// (before_s - after_s) / before_s; negative if time was lost.
double saved_share(double before_s, double after_s);

/// Training time up to `iteration`, s, linearly interpolated between log lines; constant after the last line.
double elapsed_at(const TrainHistory& history, double iteration);

/// Iteration of the first check that switched to another forward kernel. The Balanced3DGS paper calls it the
/// inflection point, and so do the keys of compare.json.
std::optional<int> first_kernel_switch(const TrainHistory& history);

/// Iterations that ran with a load-balanced forward kernel, or those that ran with any other, and the time that both
/// runs took for them.
struct KernelPart {
  std::set<std::string> kernels;
  int iterations = 0;
  double baseline_s = 0, ours_s = 0;
};

/// Two runs of one configuration with the same seed.
struct RepeatedRun {
  const TrainHistory &first, &second;
};

/// Relative difference between the times of two runs of the same configuration and seed: |first - second| / first.
struct RunToRunVariation {
  std::optional<double> overall, before, after;  // before and after the kernel switch of the run it is shown with
};

/// Share of the baseline's time that was saved, (baseline - ours) / baseline, over the iterations that both runs have
/// completed.
struct TimeSaved {
  int until = 0;  // iteration
  double baseline_s = 0, ours_s = 0;
  std::optional<int> switch_iteration;
  std::optional<double> before, after;  // the switch; empty without one, `before` also if it is at the first iteration
  double overall = 0;
  KernelPart balanced, others;  // by the kernel that `ours` used; both empty if its log does not name kernels
  RunToRunVariation noise;      // over the same iterations; empty without a repeated run
};

/// nullopt if one of the two has no log line yet.
std::optional<TimeSaved> time_saved(const TrainHistory& baseline, const TrainHistory& ours,
                                    const std::optional<RepeatedRun>& repeated = std::nullopt);

}  // namespace b3dgs
