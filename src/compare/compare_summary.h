// Results of a comparison, computed from the logs of its runs. No file access.
#pragma once

#include <cstdint>
#include <nlohmann/json.hpp>
#include <optional>
#include <set>
#include <string>
#include <vector>

#include "compare/compare_results.h"

namespace b3dgs {

inline constexpr const char* kPsnrMeasure = "PSNR, dB";

/// A measure of quality of the baseline and of another configuration, for the same seeds and the same iteration.
struct QualityDifference {
  std::string measure;  // kPsnrMeasure, ...
  int iteration = 0;    // the last one at which all configurations were measured for at least one seed
  Spread baseline, ours;
  Effect gained;                // of `ours`, in the measure's unit
  std::optional<double> noise;  // largest difference between two runs of the baseline, over seeds
};

/// A KernelPart over all seeds that have one; `saved` is the share of the baseline's time.
struct KernelPartSummary {
  std::set<std::string> kernels;
  std::optional<Spread> iterations, saved;
};

/// One configuration compared with another.
struct ComparedConfiguration {
  std::string name, baseline;
  std::vector<std::string> differs_in;  // options, except those of the forward kernel
  bool has_own_kernel = false;          // also differs in options of the forward kernel
  bool learns_differently = false;      // quality may differ, not only time
  std::vector<TimeSaved> by_seed;       // of the seeds that have started
  std::optional<Effect> overall;
  std::optional<Spread> switch_iteration;
  std::optional<Spread> before, after;  // the kernel switch; over the seeds that have both
  RunToRunVariation noise;              // largest over seeds; empty if the baseline was not trained twice
  KernelPartSummary balanced, others;
  bool was_slower_from_start = false;  // in all seeds, the first check found the balanced kernel slower
  std::vector<QualityDifference> quality;

  const QualityDifference* find_quality(const std::string& measure) const;
};

struct ComparisonSummary {
  std::string baseline, ours;     // names; `ours` is the configuration that the verdict is about
  std::string repetition;         // the second training of the baseline; "" if there is none
  bool holds_out_views = false;   // to measure quality on them
  int iterations = 0;             // requested, of the longest configuration
  int done = 0;                   // completed by all runs of the seeds that have started
  std::vector<int> done_by_seed;  // completed by all configurations; 0: the seed is ignored, not all have started
  std::vector<ComparedConfiguration> compared;
  std::vector<BalancingGain> balancing;                  // of the configurations for which it is known
  std::vector<std::string> missing_kernels;              // not trained, so the gain of `ours` is unknown
  std::vector<ComparedConfiguration> paper_comparisons;  // pairs that repeat the one in the paper (is_paper_pair)
  std::vector<FinalResult> results;                      // of all configurations, each at its own end

  int seeds_started() const;
  const ComparedConfiguration* find(const std::string& name) const;
  const BalancingGain* find_balancing(const std::string& name) const;
  /// Relative difference between the times of two runs of the baseline; nullopt if it was not trained twice.
  std::optional<double> noise() const;
};

/// `configurations`: at least two; the first is the baseline. `iterations`: how many were requested of the
/// longest.
ComparisonSummary summarize_comparison(const std::vector<ConfigurationHistory>& configurations, int iterations);

/// Explains when quality is said to differ or to be equal.
std::string quality_criterion(const ComparisonSummary& summary);

nlohmann::ordered_json to_json(const ComparisonSummary& summary);

}  // namespace b3dgs
