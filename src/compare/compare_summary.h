// What a comparison found, from the histories of its runs: numbers and sentences, no files.
#pragma once

#include <cstdint>
#include <optional>
#include <set>
#include <string>
#include <vector>

#include <nlohmann/json.hpp>

#include "compare/compare_balancing.h"
#include "report/time_saved.h"

namespace b3dgs {

/// One figure of quality, of baseline and ours: of the same seeds at the same iteration.
struct QualityDifference {
  std::string measure;  // "PSNR, dB"
  int iteration = 0;    // the latest at which all configurations were measured in some seed
  Spread baseline, ours;
  double tolerance = 0;         // the two are called equal up to this difference of their means
  std::optional<double> noise;  // the largest difference of the baseline from itself, over seeds
  /// The tolerance is the wider of the two ranges over seeds, not a figure for want of several seeds.
  bool has_ranges() const { return baseline.n > 1; }
  double difference() const { return ours.mean - baseline.mean; }
  bool is_equal() const;
  bool is_within_noise() const;
};

/// A KernelPart over seeds; spreads are of the seeds in which there was one, `saved` against the baseline.
struct KernelPartSummary {
  std::set<std::string> kernels;
  std::optional<Spread> iterations, saved;
};

/// One configuration against a baseline.
struct ComparedConfiguration {
  std::string name;
  std::vector<std::string> differs_in;  // options other than those of the forward kernel
  bool has_own_kernel = false;          // differs from the baseline in options of the forward kernel too
  std::vector<TimeSaved> by_seed;       // of those that have begun
  std::optional<Spread> overall, switch_iteration;
  std::optional<Spread> before, after;  // over the seeds that have both, or they would tell of different seeds
  RunToRunVariation noise;                  // the largest over seeds; missing without a repetition of the baseline
  KernelPartSummary balanced, others;
  bool was_slower_from_start = false;  // the first check found the balanced kernel slower, in all seeds
  std::vector<QualityDifference> quality;
};

/// What may stand beside the paper's figures.
struct PaperComparison {
  std::string baseline;
  ComparedConfiguration compared;
};

struct ComparisonSummary {
  std::string baseline, ours;     // names; "ours" is what the verdict is about: an adaptive or else a balanced one
  std::string repetition;         // the configuration that is the baseline once more; "" if there is none
  int iterations = 0;             // wanted
  int done = 0;                   // by all runs of the seeds that have begun
  std::vector<int> done_by_seed;  // by all configurations; 0: not all have begun, and nothing of the seed counts
  std::vector<ComparedConfiguration> compared;
  std::vector<BalancingGain> balancing;     // of the configurations of which they can be told
  std::vector<std::string> missing_kernels;  // unbalanced ones without which those of ours cannot be told
  std::vector<PaperComparison> paper_comparisons;

  int seeds_begun() const;
  const ComparedConfiguration* find(const std::string& name) const;
  const BalancingGain* find_balancing(const std::string& name) const;
  /// Share of its time by which the baseline differs from itself. Nothing if it was not trained twice.
  std::optional<double> noise() const;
};

/// The first configuration is the baseline; there are at least two.
ComparisonSummary summarize_comparison(const std::vector<ConfigurationHistory>& configurations, int iterations);

/// How differences of quality are judged, in a sentence or two.
std::string quality_criterion(const ComparisonSummary& summary);

nlohmann::ordered_json to_json(const ComparisonSummary& summary);

}  // namespace b3dgs
