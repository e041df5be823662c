// What a comparison found, from the histories of its runs: numbers and sentences, no files.
#pragma once

#include <cstdint>
#include <optional>
#include <set>
#include <string>
#include <vector>

#include <nlohmann/json.hpp>

#include "app/train_log_reader.h"

namespace b3dgs {

/// All runs of one configuration.
struct ConfigurationHistory {
  std::string name, kernel;
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

/// Training seconds up to `iteration`, between two lines interpolated.
double elapsed_at(const TrainHistory& history, double iteration);

/// Iteration of the first check after which another forward kernel was in use: the paper's inflection point.
std::optional<int> inflection_point(const TrainHistory& history);

/// Iterations that one forward kernel did: after `from`, up to and with `until`.
struct KernelPeriod {
  std::string kernel;
  int from = 0, until = 0;
};

/// All iterations, by the kernel that each line of the log and each check names; empty if none does.
std::vector<KernelPeriod> kernel_periods(const TrainHistory& history);

/// The part of a training that one kind of forward kernel did, balanced ones or the others.
struct KernelPart {
  std::set<std::string> kernels;
  int iterations = 0;
  double baseline_s = 0, ours_s = 0;
};

/// Shares of the baseline's time that were saved, (baseline - ours) / baseline, over the iterations that both have
/// done.
struct SavedTime {
  int until = 0;  // iteration
  double baseline_s = 0, ours_s = 0;
  std::optional<int> inflection;
  std::optional<double> before, after;  // the inflection point; missing without one, and before one at the start
  double overall = 0;
  KernelPart balanced, others;  // by ours' kernel; both empty if the log does not name it
};

/// Nothing if one of them has not begun.
std::optional<SavedTime> saved_time(const TrainHistory& baseline, const TrainHistory& ours);

/// One figure of quality, of baseline and ours: of the same seeds at the same iteration.
struct QualityDifference {
  std::string measure;  // "PSNR, dB"
  int iteration = 0;    // the latest at which all configurations were measured in some seed
  Spread baseline, ours;
  double tolerance = 0;  // the two are called equal up to this difference of their means
  /// The tolerance is the wider of the two ranges over seeds, not a figure for want of several seeds.
  bool has_ranges() const { return baseline.n > 1; }
  bool is_equal() const;
};

/// A KernelPart over seeds; spreads are of the seeds in which there was one.
struct KernelPartSummary {
  std::set<std::string> kernels;
  std::optional<Spread> iterations, saved;
};

/// One configuration against the first.
struct ComparedConfiguration {
  std::string name;
  std::vector<SavedTime> by_seed;  // of those that have begun
  std::optional<Spread> overall, inflection;
  std::optional<Spread> before, after;  // over the seeds that have both, or they would tell of different seeds
  KernelPartSummary balanced, others;
  bool was_slower_from_start = false;  // the first check found the balanced kernel slower, in all seeds
  std::vector<QualityDifference> quality;
};

struct ComparisonSummary {
  std::string baseline, ours;     // names; "ours" is what the verdict is about: the adaptive one, or else the second
  bool is_balancing = false;      // a balanced kernel, or the choice between them, against naive
  int iterations = 0;             // wanted
  int done = 0;                   // by all runs of the seeds that have begun
  std::vector<int> done_by_seed;  // by all configurations; 0: not all have begun, and nothing of the seed counts
  std::vector<ComparedConfiguration> compared;

  int seeds_begun() const;
  const ComparedConfiguration* find(const std::string& name) const;
};

/// The first configuration is the baseline; there are at least two.
ComparisonSummary summarize_comparison(const std::vector<ConfigurationHistory>& configurations, int iterations);

/// How differences of quality are judged, in a sentence or two.
std::string quality_criterion(const ComparisonSummary& summary);

nlohmann::ordered_json to_json(const ComparisonSummary& summary);

}  // namespace b3dgs
