// Times of two runs of a comparison against each other, from their logs.
#pragma once

#include <optional>
#include <set>
#include <string>
#include <vector>

#include "report/train_log_reader.h"
#include "train/config/train_config.h"

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

/// Nothing if `values` is empty.
std::optional<Spread> spread_of(const std::vector<double>& values);

/// Share of `before_s` that is saved.
double saved_share(double before_s, double after_s);

/// Training seconds up to `iteration`, between two lines interpolated.
double elapsed_at(const TrainHistory& history, double iteration);

/// Iteration of the first check after which another forward kernel was in use: the paper's inflection point.
std::optional<int> first_kernel_switch(const TrainHistory& history);

/// The part of a training that one kind of forward kernel did, balanced ones or the others.
struct KernelPart {
  std::set<std::string> kernels;
  int iterations = 0;
  double baseline_s = 0, ours_s = 0;
};

/// Two runs of one configuration and one seed.
struct RepeatedRun {
  const TrainHistory &first, &second;
};

/// By which share of its time a repeated run differs from itself.
struct RunToRunVariation {
  std::optional<double> overall, before, after;  // the inflection point of the run that it stands beside
};

/// Shares of the baseline's time that were saved, (baseline - ours) / baseline, over the iterations that both have
/// done.
struct TimeSaved {
  int until = 0;  // iteration
  double baseline_s = 0, ours_s = 0;
  std::optional<int> switch_iteration;
  std::optional<double> before, after;  // the inflection point; missing without one, and before one at the start
  double overall = 0;
  KernelPart balanced, others;  // by ours' kernel; both empty if the log does not name it
  RunToRunVariation noise;          // over the same iterations; missing without a repeated run
};

/// Nothing if one of them has not begun.
std::optional<TimeSaved> time_saved(const TrainHistory& baseline, const TrainHistory& ours,
                                    const std::optional<RepeatedRun>& repeated = std::nullopt);

}  // namespace b3dgs
