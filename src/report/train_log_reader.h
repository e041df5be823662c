// train.jsonl as curves. Whatever a line lacks is missing in the result, and a damaged line is no line: a report is
// better with a hole than not at all.
#pragma once

#include <cstdint>
#include <filesystem>
#include <iosfwd>
#include <optional>
#include <string>
#include <utility>
#include <vector>

namespace b3dgs {

/// Milliseconds by name, in the order of the file.
using NamedTimes = std::vector<std::pair<std::string, double>>;

/// A plain line.
struct LogPoint {
  int iteration = 0;
  double elapsed_s = 0;  // of training since iteration 0; summed up from `ms` where the file does not say
  std::optional<double> loss, ms, test_psnr, test_ssim;
  std::optional<std::int64_t> count, gpu_peak_bytes;
  std::string kernel, backward_kernel;  // "" if not said
  NamedTimes stages_ms;                 // mean per step, empty if not sampled
};

/// What a check found and decided.
struct KernelCheckEvent {
  int iteration = 0;
  std::string pass;                   // "forward" or "backward"
  NamedTimes times_ms;                // median over the views
  NamedTimes spread_ms;               // over the views
  std::optional<int> views;           // on which they were timed
  std::string before, after, reason;  // kernel in use
  std::vector<std::string> refused;   // candidates that computed something else, and are not used from here on
  std::optional<double> cost_ms;
  std::optional<double> warm_up_ms;  // before the first check of a pass, not part of its cost

  bool has_changed() const { return !after.empty() && before != after; }
};

/// Candidates timed on the data of the moment: by a check, or for the record only.
struct CandidateTimes {
  int iteration = 0;
  std::string pass;
  NamedTimes times_ms;
};

/// How unevenly work is spread: LoadStatistics (adaptive/load_statistics.h) as read back.
struct LoadFigures {
  double min = 0, median = 0, p90 = 0, p99 = 0, max = 0, mean = 0, gini = 0;
  std::vector<double> log2_bins;  // counts; bin 0: value 0, bin k: values in [2^(k-1), 2^k)
};

struct LoadEvent {
  int iteration = 0;
  std::optional<LoadFigures> tile_lists, pixel_processed, pixel_contributing;
};

/// From then on the number of Gaussians did not grow beyond `count`.
struct HoldEvent {
  int iteration = 0;
  std::int64_t count = 0;
  std::string reason;
};

/// A training that was continued, with the kernels in use from there on.
struct ResumeEvent {
  int iteration = 0;  // last one done
  std::string kernel, backward_kernel;
  std::vector<std::string> changed_options;  // "name: old -> new"
};

struct TrainHistory {
  std::vector<LogPoint> points;  // by iteration, as all of these
  std::vector<KernelCheckEvent> checks;
  std::vector<CandidateTimes> candidate_times;  // of checks too; one for each iteration and pass
  std::vector<LoadEvent> loads;
  std::vector<HoldEvent> holds;
  std::vector<ResumeEvent> resumes;

  int last_iteration() const { return points.empty() ? 0 : points.back().iteration; }
};

/// Iterations that one forward kernel did: after `from`, up to and with `until`.
struct KernelPeriod {
  std::string kernel;
  int from = 0, until = 0;
};

/// All iterations, by the kernel that each line of the log and each check names; empty if none does.
std::vector<KernelPeriod> kernel_periods(const TrainHistory& history);

TrainHistory parse_train_log(std::istream& lines);

/// Empty if there is no such file.
TrainHistory read_train_log(const std::filesystem::path& path);

}  // namespace b3dgs
