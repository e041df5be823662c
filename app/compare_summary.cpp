#include "app/compare_summary.h"

#include <algorithm>
#include <cmath>
#include <map>

#include "app/compare_verdict.h"
#include "app/print.h"
#include "check.h"
#include "train/train_config.h"

namespace b3dgs {
namespace {

constexpr const char* kForwardPass = "forward";  // as in train.jsonl

using Json = nlohmann::ordered_json;

struct Measure {
  const char* name;
  double one_seed_tolerance;  // where the runs say nothing of their own spread
  bool is_relative;           // to the baseline
  std::optional<double> (*value)(const LogPoint& point);
};

constexpr Measure kMeasures[] = {
    {"PSNR, dB", 0.1, false, [](const LogPoint& point) { return point.test_psnr; }},
    {"SSIM", 0.003, false, [](const LogPoint& point) { return point.test_ssim; }},
    {"Gaussians", 0.02, true,
     [](const LogPoint& point) {
       return point.count ? std::optional(static_cast<double>(*point.count)) : std::nullopt;
     }},
};

double saved_share(double baseline_s, double ours_s) {
  return (baseline_s - ours_s) / baseline_s;
}

/// Values of one run by iteration.
std::map<int, double> measured(const TrainHistory& history, const Measure& measure) {
  std::map<int, double> values;
  for (const LogPoint& point : history.points) {
    if (const std::optional<double> value = measure.value(point)) values[point.iteration] = *value;
  }
  return values;
}

/// The latest iteration at which a seed was measured in all configurations, and all seeds that were.
struct CommonMeasurement {
  int iteration = 0;  // 0: there is none
  std::vector<std::size_t> seeds;
};

CommonMeasurement common_measurement(const std::vector<ConfigurationHistory>& configurations, std::size_t n_seeds,
                                     const Measure& measure) {
  CommonMeasurement common;
  for (std::size_t seed = 0; seed < n_seeds; ++seed) {
    std::map<int, std::size_t> n_measured;  // configurations by iteration
    for (const ConfigurationHistory& configuration : configurations) {
      for (const auto& [iteration, value] : measured(configuration.by_seed[seed], measure)) ++n_measured[iteration];
    }
    int last = 0;
    for (const auto& [iteration, n] : n_measured) {
      if (n == configurations.size()) last = iteration;
    }
    if (last > common.iteration) common = {last, {}};
    if (last > 0 && last == common.iteration) common.seeds.push_back(seed);
  }
  return common;
}

Spread values_at(const CommonMeasurement& common, const ConfigurationHistory& configuration, const Measure& measure) {
  std::vector<double> values;
  for (const std::size_t seed : common.seeds) {
    values.push_back(measured(configuration.by_seed[seed], measure).at(common.iteration));
  }
  return *spread_of(values);
}

/// Of ours = configurations[index] and the baseline. Times are cut at what all have done, and so is quality: figures
/// of different iterations do not compare.
std::vector<QualityDifference> compare_quality(const std::vector<ConfigurationHistory>& configurations,
                                               std::size_t index, std::size_t n_seeds) {
  std::vector<QualityDifference> differences;
  for (const Measure& measure : kMeasures) {
    const CommonMeasurement common = common_measurement(configurations, n_seeds, measure);
    if (common.seeds.empty()) continue;
    QualityDifference difference{measure.name, common.iteration, values_at(common, configurations[0], measure),
                                 values_at(common, configurations[index], measure)};
    const Spread &baseline = difference.baseline, &ours = difference.ours;
    difference.tolerance = difference.has_ranges()
                               ? std::max(baseline.range(), ours.range())
                               : measure.one_seed_tolerance * (measure.is_relative ? baseline.mean : 1);
    differences.push_back(difference);
  }
  return differences;
}

KernelPartSummary summarize_part(const std::vector<SavedTime>& by_seed, KernelPart SavedTime::*part) {
  KernelPartSummary summary;
  std::vector<double> iterations, saved;
  for (const SavedTime& seed : by_seed) {
    const KernelPart& own = seed.*part;
    summary.kernels.insert(own.kernels.begin(), own.kernels.end());
    if (own.iterations == 0 || own.baseline_s <= 0) continue;
    iterations.push_back(own.iterations);
    saved.push_back(saved_share(own.baseline_s, own.ours_s));
  }
  summary.iterations = spread_of(iterations);
  summary.saved = spread_of(saved);
  return summary;
}

/// Whether the check before the first step went over from a balanced kernel because of its time.
bool was_balanced_slower_from_start(const TrainHistory& history) {
  return std::any_of(history.checks.begin(), history.checks.end(), [](const KernelCheckEvent& check) {
    const bool is_refused = std::find(check.refused.begin(), check.refused.end(), check.before) != check.refused.end();
    return check.iteration == 1 && check.pass == kForwardPass && check.has_changed() && !is_refused &&
           is_balanced_kernel(check.before) && !is_balanced_kernel(check.after);
  });
}

/// Over the seeds that have begun.
ComparedConfiguration compare_times(const ConfigurationHistory& baseline, const ConfigurationHistory& ours,
                                    const std::vector<int>& done_by_seed) {
  ComparedConfiguration compared;
  compared.name = ours.name;
  std::vector<double> overall, before, after, inflection;
  compared.was_slower_from_start = true;
  for (std::size_t seed = 0; seed < done_by_seed.size(); ++seed) {
    if (done_by_seed[seed] == 0) continue;
    const std::optional<SavedTime> saved = saved_time(baseline.by_seed[seed], ours.by_seed[seed]);
    if (!saved) continue;
    compared.by_seed.push_back(*saved);
    compared.was_slower_from_start =
        compared.was_slower_from_start && was_balanced_slower_from_start(ours.by_seed[seed]);
    overall.push_back(saved->overall);
    if (saved->inflection) inflection.push_back(*saved->inflection);
    if (!saved->before || !saved->after) continue;
    before.push_back(*saved->before);
    after.push_back(*saved->after);
  }
  compared.overall = spread_of(overall);
  compared.before = spread_of(before);
  compared.after = spread_of(after);
  compared.inflection = spread_of(inflection);
  compared.balanced = summarize_part(compared.by_seed, &SavedTime::balanced);
  compared.others = summarize_part(compared.by_seed, &SavedTime::others);
  return compared;
}

/// Iterations that all configurations have done, by seed.
std::vector<int> common_iterations(const std::vector<ConfigurationHistory>& configurations, int wanted) {
  std::vector<int> done(configurations[0].by_seed.size(), wanted);
  for (const ConfigurationHistory& configuration : configurations) {
    B3DGS_CHECK(configuration.by_seed.size() == done.size(), configuration.name, " has ", configuration.by_seed.size(),
                " seeds, ", configurations[0].name, " has ", done.size());
    for (std::size_t seed = 0; seed < done.size(); ++seed) {
      done[seed] = std::min(done[seed], configuration.by_seed[seed].last_iteration());
    }
  }
  return done;
}

Json to_json(const std::optional<Spread>& spread) {
  if (!spread) return nullptr;
  return {{"mean", spread->mean}, {"min", spread->min}, {"max", spread->max}, {"n", spread->n}};
}

Json to_json(const KernelPartSummary& part) {
  return {{"names", part.kernels}, {"iterations", to_json(part.iterations)}, {"saved", to_json(part.saved)}};
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

std::optional<int> inflection_point(const TrainHistory& history) {
  for (const KernelCheckEvent& check : history.checks) {
    if (check.pass == kForwardPass && check.has_changed()) return check.iteration;
  }
  return std::nullopt;
}

std::vector<KernelPeriod> kernel_periods(const TrainHistory& history) {
  std::map<int, std::string> kernel_of;  // iteration; where it is known
  for (const LogPoint& point : history.points) {
    if (!point.kernel.empty()) kernel_of[point.iteration] = point.kernel;
  }
  for (const KernelCheckEvent& check : history.checks) {  // each comes before the step of its iteration
    if (check.pass != kForwardPass || check.before.empty() || check.after.empty()) continue;
    if (check.iteration > 1) kernel_of[check.iteration - 1] = check.before;
    kernel_of[check.iteration] = check.after;
  }
  std::vector<KernelPeriod> periods;
  for (const auto& [iteration, kernel] : kernel_of) {
    if (periods.empty() || periods.back().kernel != kernel) {
      periods.push_back({kernel, periods.empty() ? 0 : periods.back().until, iteration});
    }
    periods.back().until = iteration;
  }
  if (!periods.empty()) periods.back().until = std::max(periods.back().until, history.last_iteration());
  return periods;
}

std::optional<SavedTime> saved_time(const TrainHistory& baseline, const TrainHistory& ours) {
  SavedTime saved;
  saved.until = std::min(baseline.last_iteration(), ours.last_iteration());
  saved.baseline_s = elapsed_at(baseline, saved.until);
  saved.ours_s = elapsed_at(ours, saved.until);
  if (saved.until == 0 || saved.baseline_s <= 0) return std::nullopt;
  saved.overall = saved_share(saved.baseline_s, saved.ours_s);
  saved.inflection = inflection_point(ours);
  if (saved.inflection && *saved.inflection < saved.until) {
    const int last_before = *saved.inflection - 1;
    const double baseline_s = elapsed_at(baseline, last_before), ours_s = elapsed_at(ours, last_before);
    if (baseline_s > 0) saved.before = saved_share(baseline_s, ours_s);
    if (saved.baseline_s > baseline_s) saved.after = saved_share(saved.baseline_s - baseline_s, saved.ours_s - ours_s);
  }
  for (const KernelPeriod& period : kernel_periods(ours)) {
    const int until = std::min(period.until, saved.until);
    if (until <= period.from) continue;
    KernelPart& part = is_balanced_kernel(period.kernel) ? saved.balanced : saved.others;
    part.kernels.insert(period.kernel);
    part.iterations += until - period.from;
    part.baseline_s += elapsed_at(baseline, until) - elapsed_at(baseline, period.from);
    part.ours_s += elapsed_at(ours, until) - elapsed_at(ours, period.from);
  }
  return saved;
}

bool QualityDifference::is_equal() const {
  return std::fabs(ours.mean - baseline.mean) <= tolerance;
}

int ComparisonSummary::seeds_begun() const {
  return static_cast<int>(std::count_if(done_by_seed.begin(), done_by_seed.end(), [](int done) { return done > 0; }));
}

const ComparedConfiguration* ComparisonSummary::find(const std::string& name) const {
  const auto it = std::find_if(compared.begin(), compared.end(), [&](const auto& own) { return own.name == name; });
  return it == compared.end() ? nullptr : &*it;
}

ComparisonSummary summarize_comparison(const std::vector<ConfigurationHistory>& configurations, int iterations) {
  B3DGS_CHECK(configurations.size() >= 2, configurations.size(), " configurations");
  const ConfigurationHistory& baseline = configurations[0];
  const auto is_adaptive = [](const ConfigurationHistory& own) { return own.kernel == kAdaptive; };
  const auto adaptive = std::find_if(configurations.begin() + 1, configurations.end(), is_adaptive);
  const ConfigurationHistory& ours = adaptive != configurations.end() ? *adaptive : configurations[1];

  ComparisonSummary summary;
  summary.baseline = baseline.name;
  summary.ours = ours.name;
  summary.is_balancing = baseline.kernel == forward_kernel_name(ForwardKernel::kNaive) &&
                         (ours.kernel == kAdaptive || is_balanced_kernel(ours.kernel));
  summary.iterations = iterations;
  summary.done_by_seed = common_iterations(configurations, iterations);
  for (const int done : summary.done_by_seed) {
    if (done > 0) summary.done = summary.done == 0 ? done : std::min(summary.done, done);
  }
  for (std::size_t i = 1; i < configurations.size(); ++i) {
    summary.compared.push_back(compare_times(baseline, configurations[i], summary.done_by_seed));
    summary.compared.back().quality = compare_quality(configurations, i, summary.done_by_seed.size());
  }
  return summary;
}

std::string quality_criterion(const ComparisonSummary& summary) {
  bool some_have_ranges = false, some_have_none = false;
  for (const ComparedConfiguration& compared : summary.compared) {
    for (const QualityDifference& difference : compared.quality) {
      (difference.has_ranges() ? some_have_ranges : some_have_none) = true;
    }
  }
  std::string text;
  if (some_have_ranges) {
    text = "Called equal where the means differ by no more than the wider of the two ranges over seeds.";
  }
  if (some_have_none) {
    std::string limits;
    for (const Measure& measure : kMeasures) {
      limits += (limits.empty() ? "" : "; ") + std::string(measure.name) + " " +
                (measure.is_relative ? format_whole_percent(measure.one_seed_tolerance)
                                     : print_to_string("%g", measure.one_seed_tolerance));
    }
    text += (text.empty() ? "" : " ") +
            ("One seed says nothing of the spread between runs (--seeds would): called equal up to " + limits + ".");
  }
  return text;
}

Json to_json(const ComparisonSummary& summary) {
  Json compared = Json::array();
  for (const ComparedConfiguration& own : summary.compared) {
    Json quality = Json::array(), by_seed = Json::array();
    for (const SavedTime& saved : own.by_seed) {
      by_seed.push_back({{"until", saved.until}, {"baseline_s", saved.baseline_s}, {"ours_s", saved.ours_s}});
    }
    for (const QualityDifference& difference : own.quality) {
      quality.push_back({{"measure", difference.measure},
                         {"iteration", difference.iteration},
                         {"baseline", to_json(std::optional(difference.baseline))},
                         {"ours", to_json(std::optional(difference.ours))},
                         {"tolerance", difference.tolerance},
                         {"equal", difference.is_equal()}});
    }
    compared.push_back({{"name", own.name},
                        {"saved_overall", to_json(own.overall)},
                        {"saved_before_inflection", to_json(own.before)},
                        {"saved_after_inflection", to_json(own.after)},
                        {"inflection", to_json(own.inflection)},
                        {"balanced_kernels", to_json(own.balanced)},
                        {"other_kernels", to_json(own.others)},
                        {"by_seed", by_seed},
                        {"quality", quality}});
  }
  return {{"verdict", verdict(summary)}, {"baseline", summary.baseline},
          {"ours", summary.ours},        {"iterations", summary.iterations},
          {"done", summary.done},        {"done_by_seed", summary.done_by_seed},
          {"compared", compared}};
}

}  // namespace b3dgs
