// Reads train.jsonl into time series. Fields missing from a line stay empty and damaged lines are skipped, so that a
// report can always be written.
#pragma once

#include <cstdint>
#include <filesystem>
#include <iosfwd>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "adaptive/load_statistics.h"

namespace b3dgs {

/// KernelCheckEvent::pass of the forward kernels.
inline constexpr const char* kForwardPass = "forward";

/// Milliseconds by name, in the order of the file.
using NamedTimes = std::vector<std::pair<std::string, double>>;

/// A line without "event": the state of training after `iteration`.
struct LogPoint {
  int iteration = 0;
  double elapsed_s = 0;  // training time since iteration 0
  std::optional<double> loss, ms, test_psnr, test_ssim;
  std::optional<std::int64_t> count, gpu_peak_bytes;
  std::string kernel, backward_kernel;  // "" if the line does not name it
  NamedTimes stages_ms;                 // mean per step; empty if stages were not timed

  /// Calls field(key, member) for what is drawn over the iterations, with its key in train.jsonl and compare.json.
  template <class Point, class Field>
  static void visit_curves(Point& point, Field&& field) {
    field("iteration", point.iteration);
    field("elapsed_s", point.elapsed_s);
    field("ms", point.ms);
    field("loss", point.loss);
    field("count", point.count);
    field("test_psnr", point.test_psnr);
    field("test_ssim", point.test_ssim);
    field("kernel", point.kernel);
    field("backward_kernel", point.backward_kernel);
  }
};

/// A timing check of the candidate kernels of one pass.
struct KernelCheckEvent {
  int iteration = 0;
  std::string pass;                   // "forward" or "backward"
  NamedTimes times_ms;                // median over the views
  NamedTimes spread_ms;               // spread over the views
  std::optional<int> views;           // number of views that were timed
  std::string before, after, reason;  // kernel in use
  std::vector<std::string> disabled;  // candidates disabled because their results differ from the reference kernel
  std::optional<double> cost_ms;
  std::optional<double> warm_up_ms;  // loading the kernels before the first check of a pass; not part of cost_ms

  bool has_changed() const { return !after.empty() && before != after; }

  /// Calls field(key, member) with the keys of train.jsonl and compare.json.
  template <class Check, class Field>
  static void visit(Check& check, Field&& field) {
    field("iteration", check.iteration);
    field("pass", check.pass);
    field("times_ms", check.times_ms);
    field("spread_ms", check.spread_ms);
    field("views", check.views);
    field("before", check.before);
    field("after", check.after);
    field("reason", check.reason);
    field("refused", check.disabled);
    field("cost_ms", check.cost_ms);
    field("warm_up_ms", check.warm_up_ms);
  }
};

/// Times of the candidate kernels on the current model: from a check, or measured for the log only.
struct CandidateTimes {
  int iteration = 0;
  std::string pass;
  NamedTimes times_ms;
};

/// Distribution of work.
struct LoadEvent {
  int iteration = 0;
  std::optional<LoadStatistics> tile_lists, pixel_processed, pixel_contributing;
};

/// The limit on the number of Gaussians was reached: from here on it does not exceed `count`.
struct HoldEvent {
  int iteration = 0;
  std::int64_t count = 0;
  std::string reason;
};

/// Training was resumed, with the kernels in use from here on.
struct ResumeEvent {
  int iteration = 0;  // last one before the interruption
  std::string kernel, backward_kernel;
  std::vector<std::string> changed_options;  // "name: old -> new"
};

/// Gaussians that may be floaters, after the last iteration (count_floaters()).
struct FloaterEvent {
  int iteration = 0;
  std::int64_t unseen = 0, one_view = 0, close = 0, large = 0;
};

struct TrainHistory {
  std::vector<LogPoint> points;  // ascending by iteration, like all lists here
  std::vector<KernelCheckEvent> checks;
  std::vector<CandidateTimes> candidate_times;  // including those of checks; one per iteration and pass
  std::vector<LoadEvent> loads;
  std::vector<HoldEvent> holds;
  std::vector<ResumeEvent> resumes;
  std::vector<FloaterEvent> floaters;

  int last_iteration() const { return points.empty() ? 0 : points.back().iteration; }
};

/// A forward kernel that was in use from iteration from + 1 to until.
struct KernelPeriod {
  std::string kernel;
  int from = 0, until = 0;
};

/// Splits the training by forward kernel, as named by log lines and checks; empty if none names a kernel.
std::vector<KernelPeriod> kernel_periods(const TrainHistory& history);

TrainHistory parse_train_log(std::istream& lines);

/// Empty if the file does not exist.
TrainHistory read_train_log(const std::filesystem::path& path);

}  // namespace b3dgs
