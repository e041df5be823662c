#include "report/time_saved.h"

#include <algorithm>
#include <cmath>

namespace b3dgs {
namespace {

constexpr const char* kForwardPass = "forward";  // as in train.jsonl

double seconds_between(const TrainHistory& history, int from, int until) {
  return elapsed_at(history, until) - elapsed_at(history, from);
}

/// Over the iterations from + 1 to until.
std::optional<double> run_to_run_variation(const std::optional<RepeatedRun>& repeated, int from, int until) {
  if (!repeated || std::min(repeated->first.last_iteration(), repeated->second.last_iteration()) < until) {
    return std::nullopt;
  }
  const double first_s = seconds_between(repeated->first, from, until);
  if (first_s <= 0) return std::nullopt;
  return std::fabs(saved_share(first_s, seconds_between(repeated->second, from, until)));
}

}  // namespace

std::optional<Spread> spread_of(const std::vector<double>& values) {
  if (values.empty()) return std::nullopt;
  Spread spread{0, values[0], values[0], static_cast<int>(values.size())};
  for (const double value : values) {
    spread.mean += value / spread.n;
    spread.min = std::min(spread.min, value);
    spread.max = std::max(spread.max, value);
  }
  return spread;
}

double saved_share(double before_s, double after_s) {
  return (before_s - after_s) / before_s;
}

double elapsed_at(const TrainHistory& history, double iteration) {
  double from_iteration = 0, from_s = 0;
  for (const LogPoint& point : history.points) {
    if (point.iteration >= iteration) {
      const double share = (iteration - from_iteration) / (point.iteration - from_iteration);
      return from_s + share * (point.elapsed_s - from_s);
    }
    from_iteration = point.iteration;
    from_s = point.elapsed_s;
  }
  return from_s;
}

std::optional<int> first_kernel_switch(const TrainHistory& history) {
  for (const KernelCheckEvent& check : history.checks) {
    if (check.pass == kForwardPass && check.has_changed()) return check.iteration;
  }
  return std::nullopt;
}

std::optional<TimeSaved> time_saved(const TrainHistory& baseline, const TrainHistory& ours,
                                    const std::optional<RepeatedRun>& repeated) {
  TimeSaved saved;
  saved.until = std::min(baseline.last_iteration(), ours.last_iteration());
  saved.baseline_s = elapsed_at(baseline, saved.until);
  saved.ours_s = elapsed_at(ours, saved.until);
  if (saved.until == 0 || saved.baseline_s <= 0) return std::nullopt;
  saved.overall = saved_share(saved.baseline_s, saved.ours_s);
  saved.noise.overall = run_to_run_variation(repeated, 0, saved.until);
  saved.switch_iteration = first_kernel_switch(ours);
  if (saved.switch_iteration && *saved.switch_iteration < saved.until) {
    const int last_before = *saved.switch_iteration - 1;
    const double baseline_s = elapsed_at(baseline, last_before), ours_s = elapsed_at(ours, last_before);
    if (baseline_s > 0) saved.before = saved_share(baseline_s, ours_s);
    if (saved.baseline_s > baseline_s) saved.after = saved_share(saved.baseline_s - baseline_s, saved.ours_s - ours_s);
    saved.noise.before = run_to_run_variation(repeated, 0, last_before);
    saved.noise.after = run_to_run_variation(repeated, last_before, saved.until);
  }
  for (const KernelPeriod& period : kernel_periods(ours)) {
    const int until = std::min(period.until, saved.until);
    if (until <= period.from) continue;
    KernelPart& part = is_balanced_kernel(period.kernel) ? saved.balanced : saved.others;
    part.kernels.insert(period.kernel);
    part.iterations += until - period.from;
    part.baseline_s += seconds_between(baseline, period.from, until);
    part.ours_s += seconds_between(ours, period.from, until);
  }
  return saved;
}

}  // namespace b3dgs
