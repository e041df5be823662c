#include "compare/compare_summary.h"

#include <algorithm>
#include <cmath>

#include "compare/compare_config.h"
#include "compare/compare_verdict.h"
#include "core/check.h"
#include "core/text.h"

namespace b3dgs {
namespace {

struct Measure {
  const char* name;
  EffectLimits limits;
  bool is_relative;  // the limits are shares of the baseline's value
  std::optional<double> (*value)(const LogPoint& point);
};

constexpr Measure kMeasures[] = {
    {kPsnrMeasure, kPsnrLimits, false, [](const LogPoint& point) { return point.test_psnr; }},
    {"SSIM", {0.003, 0.03}, false, [](const LogPoint& point) { return point.test_ssim; }},
    {"Gaussians",
     {0.02, 0.2},
     true,
     [](const LogPoint& point) {
       return point.count ? std::optional(static_cast<double>(*point.count)) : std::nullopt;
     }},
};

/// Empty if it was not measured after this iteration.
std::optional<double> value_at(const TrainHistory& history, int iteration, const Measure& measure) {
  const auto point = std::lower_bound(history.points.begin(), history.points.end(), iteration,
                                      [](const LogPoint& own, int wanted) { return own.iteration < wanted; });
  const bool is_logged = point != history.points.end() && point->iteration == iteration;
  return is_logged ? measure.value(*point) : std::nullopt;
}

/// The last iteration at which all configurations were measured for some seed, and the seeds for which they were.
struct CommonMeasurement {
  int iteration = 0;  // 0 if there is none
  std::vector<std::size_t> seeds;
};

CommonMeasurement common_measurement(const std::vector<ConfigurationHistory>& configurations, const Measure& measure) {
  CommonMeasurement common;
  for (std::size_t seed = 0; seed < configurations[0].by_seed.size(); ++seed) {
    const std::vector<LogPoint>& points = configurations[0].by_seed[seed].points;
    const auto last = std::find_if(points.rbegin(), points.rend(), [&](const LogPoint& point) {
      return std::all_of(configurations.begin(), configurations.end(), [&](const ConfigurationHistory& own) {
        return value_at(own.by_seed[seed], point.iteration, measure).has_value();
      });
    });
    if (last == points.rend()) continue;
    if (last->iteration > common.iteration) common = {last->iteration, {}};
    if (last->iteration == common.iteration) common.seeds.push_back(seed);
  }
  return common;
}

/// One value per seed of `common`.
std::vector<double> values_at(const CommonMeasurement& common, const ConfigurationHistory& configuration,
                              const Measure& measure) {
  std::vector<double> values;
  for (const std::size_t seed : common.seeds) {
    values.push_back(value_at(configuration.by_seed[seed], common.iteration, measure).value());
  }
  return values;
}

std::vector<double> differences(const std::vector<double>& from, const std::vector<double>& to) {
  std::vector<double> all;
  for (std::size_t i = 0; i < from.size(); ++i) all.push_back(to[i] - from[i]);
  return all;
}

/// Compares configurations[index] with the baseline at an iteration that all configurations have reached. `repetition`,
/// the second training of the baseline, may be null.
std::vector<QualityDifference> compare_quality(const std::vector<ConfigurationHistory>& configurations,
                                               std::size_t index, const ConfigurationHistory* repetition) {
  std::vector<QualityDifference> compared;
  for (const Measure& measure : kMeasures) {
    const CommonMeasurement common = common_measurement(configurations, measure);
    if (common.seeds.empty()) continue;
    const std::vector<double> before = values_at(common, configurations[0], measure),
                              after = values_at(common, configurations[index], measure);
    QualityDifference difference;
    difference.measure = measure.name;
    difference.iteration = common.iteration;
    difference.baseline = *spread_of(before);
    difference.ours = *spread_of(after);
    const double unit = measure.is_relative ? difference.baseline.mean : 1;
    EffectLimits limits{measure.limits.floor * unit, measure.limits.one_seed * unit};
    if (repetition != nullptr) {
      difference.noise = 0;
      for (const double own : differences(before, values_at(common, *repetition, measure))) {
        difference.noise = std::max(*difference.noise, std::fabs(own));
      }
      // The two runs may agree to the last bit, and other options round differently: the fixed limit stays.
      limits.one_seed = std::max(limits.one_seed, limit_with_noise(*difference.noise));
    }
    difference.gained = *effect_of(differences(before, after), limits);
    compared.push_back(difference);
  }
  return compared;
}

KernelPartSummary summarize_part(const std::vector<TimeSaved>& by_seed, KernelPart TimeSaved::*part) {
  KernelPartSummary summary;
  std::vector<double> iterations, saved;
  for (const TimeSaved& seed : by_seed) {
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

/// Whether the check before the first step switched away from a balanced kernel because it was slower.
bool was_balanced_slower_from_start(const TrainHistory& history) {
  return std::any_of(history.checks.begin(), history.checks.end(), [](const KernelCheckEvent& check) {
    const bool is_disabled =
        std::find(check.disabled.begin(), check.disabled.end(), check.before) != check.disabled.end();
    return check.iteration == 1 && check.pass == kForwardPass && check.has_changed() && !is_disabled &&
           is_balanced_kernel(check.before) && !is_balanced_kernel(check.after);
  });
}

/// Over the seeds that have started. `repeated`: by seed; empty if the baseline was not trained twice.
ComparedConfiguration compare_times(const ConfigurationHistory& baseline, const ConfigurationHistory& ours,
                                    const std::vector<RepeatedRun>& repeated, const std::vector<int>& done_by_seed) {
  ComparedConfiguration compared;
  compared.name = ours.name;
  compared.baseline = baseline.name;
  const DifferingOptions differing = differing_options(baseline.config, ours.config);
  compared.differs_in = differing.others;
  compared.has_own_kernel = !differing.forward_kernel.empty();
  compared.learns_differently = learns_differently(baseline.config, ours.config);
  std::vector<double> overall, before, after, switch_iterations;
  compared.was_slower_from_start = true;
  for (std::size_t seed = 0; seed < done_by_seed.size(); ++seed) {
    if (done_by_seed[seed] == 0) continue;
    const std::optional<TimeSaved> saved =
        time_saved(baseline.by_seed[seed], ours.by_seed[seed], repeated.empty() ? nullptr : &repeated[seed]);
    if (!saved) continue;
    compared.by_seed.push_back(*saved);
    compared.was_slower_from_start =
        compared.was_slower_from_start && was_balanced_slower_from_start(ours.by_seed[seed]);
    overall.push_back(saved->overall);
    compared.noise.overall = std::max(compared.noise.overall, saved->noise.overall);
    compared.noise.before = std::max(compared.noise.before, saved->noise.before);
    compared.noise.after = std::max(compared.noise.after, saved->noise.after);
    if (saved->switch_iteration) switch_iterations.push_back(*saved->switch_iteration);
    if (!saved->before || !saved->after) continue;
    before.push_back(*saved->before);
    after.push_back(*saved->after);
  }
  compared.overall = effect_of(overall, time_limits(compared.noise.overall));
  compared.before = spread_of(before);
  compared.after = spread_of(after);
  compared.switch_iteration = spread_of(switch_iterations);
  compared.balanced = summarize_part(compared.by_seed, &TimeSaved::balanced);
  compared.others = summarize_part(compared.by_seed, &TimeSaved::others);
  return compared;
}

/// Iterations that all configurations have completed, by seed.
std::vector<int> common_iterations(const std::vector<ConfigurationHistory>& configurations, int requested) {
  std::vector<int> done(configurations[0].by_seed.size(), requested);
  for (const ConfigurationHistory& configuration : configurations) {
    B3DGS_CHECK(configuration.by_seed.size() == done.size(), configuration.name, " has ", configuration.by_seed.size(),
                " seeds, ", configurations[0].name, " has ", done.size());
    for (std::size_t seed = 0; seed < done.size(); ++seed) {
      done[seed] = std::min(done[seed], configuration.by_seed[seed].last_iteration());
    }
  }
  return done;
}

/// The configuration that the verdict is about: the first adaptive one after the baseline, else the first that may use
/// a load-balanced kernel, else the second.
const ConfigurationHistory& choose_ours(const std::vector<ConfigurationHistory>& configurations) {
  const auto is_adaptive = [](const ConfigurationHistory& own) { return own.config.kernel == kAdaptive; };
  const auto balances = [](const ConfigurationHistory& own) { return may_balance(own.config); };
  auto ours = std::find_if(configurations.begin() + 1, configurations.end(), is_adaptive);
  if (ours == configurations.end()) ours = std::find_if(configurations.begin() + 1, configurations.end(), balances);
  return ours == configurations.end() ? configurations[1] : *ours;
}

/// The item whose member has the value, or null.
template <class Item>
const Item* find_item(const std::vector<Item>& items, std::string Item::*member, const std::string& value) {
  const auto it = std::find_if(items.begin(), items.end(), [&](const Item& own) { return own.*member == value; });
  return it == items.end() ? nullptr : &*it;
}

}  // namespace

int ComparisonSummary::seeds_started() const {
  return static_cast<int>(std::count_if(done_by_seed.begin(), done_by_seed.end(), [](int done) { return done > 0; }));
}

const QualityDifference* ComparedConfiguration::find_quality(const std::string& wanted) const {
  return find_item(quality, &QualityDifference::measure, wanted);
}

const ComparedConfiguration* ComparisonSummary::find(const std::string& name) const {
  return find_item(compared, &ComparedConfiguration::name, name);
}

const BalancingGain* ComparisonSummary::find_balancing(const std::string& name) const {
  return find_item(balancing, &BalancingGain::name, name);
}

std::optional<double> ComparisonSummary::noise() const {
  const ComparedConfiguration* const own = find(repetition);
  return own == nullptr ? std::nullopt : own->noise.overall;
}

ComparisonSummary summarize_comparison(const std::vector<ConfigurationHistory>& configurations, int iterations) {
  B3DGS_CHECK(configurations.size() >= 2, configurations.size(), " configurations");
  const ConfigurationHistory& baseline = configurations[0];
  const ConfigurationHistory& ours = choose_ours(configurations);
  const auto again = std::find_if(configurations.begin() + 1, configurations.end(), [&](const auto& own) {
    return differing_options(baseline.config, own.config).empty();
  });
  const ConfigurationHistory* const repetition = again == configurations.end() ? nullptr : &*again;

  ComparisonSummary summary;
  summary.baseline = baseline.name;
  summary.ours = ours.name;
  if (repetition != nullptr) summary.repetition = repetition->name;
  summary.holds_out_views = baseline.config.eval;
  summary.iterations = iterations;
  summary.results = final_results(configurations);
  summary.done_by_seed = common_iterations(configurations, iterations);
  std::vector<RepeatedRun> repeated;
  for (std::size_t seed = 0; repetition != nullptr && seed < baseline.by_seed.size(); ++seed) {
    repeated.push_back({baseline.by_seed[seed], repetition->by_seed[seed]});
  }
  for (const int done : summary.done_by_seed) {
    if (done > 0) summary.done = summary.done == 0 ? done : std::min(summary.done, done);
  }
  for (std::size_t i = 1; i < configurations.size(); ++i) {
    summary.compared.push_back(compare_times(baseline, configurations[i], repeated, summary.done_by_seed));
    summary.compared.back().quality = compare_quality(configurations, i, repetition);
  }
  for (std::size_t i = 0; i < configurations.size(); ++i) {
    if (const auto gain = balancing_gain(configurations, i, summary.done_by_seed, summary.noise())) {
      summary.balancing.push_back(*gain);
    }
  }
  if (may_balance(ours.config)) summary.missing_kernels = missing_unbalanced_kernels(configurations, ours.config);
  for (const ConfigurationHistory& own : configurations) {
    for (const ConfigurationHistory& other : configurations) {
      if (!is_paper_pair(own.config, other.config)) continue;
      summary.paper_comparisons.push_back(compare_times(own, other, repeated, summary.done_by_seed));
    }
  }
  return summary;
}

std::string quality_criterion(const ComparisonSummary& summary) {
  bool some_have_several = false, some_have_one = false;
  for (const ComparedConfiguration& compared : summary.compared) {
    for (const QualityDifference& own : compared.quality)
      (own.baseline.n > 1 ? some_have_several : some_have_one) = true;
  }
  const auto limits = [](double EffectLimits::*limit) {
    std::string text;
    for (const Measure& measure : kMeasures) {
      text += (text.empty() ? "" : "; ") + std::string(measure.name) + " " +
              (measure.is_relative ? format_whole_percent(measure.limits.*limit)
                                   : print_to_string("%g", measure.limits.*limit));
    }
    return text;
  };
  std::string text;
  if (some_have_several) {
    text =
        "95 %: the interval of the mean difference over the seeds (Student's t, the runs of a seed paired). "
        "\"Differs\": it excludes 0, and the mean is at least " +
        limits(&EffectLimits::floor) + ". \"Equal\": it lies within these limits. \"Unclear\": neither.";
  }
  if (some_have_one) {
    text += (text.empty() ? "" : " ") +
            ("With one seed, differences below " + limits(&EffectLimits::one_seed) +
             " say nothing (\"unclear\"); --seeds 0,1,2 tells more." +
             (summary.repetition.empty() ? "" : " Nor do those below 12.7 times the run-to-run variation."));
  }
  return text;
}

}  // namespace b3dgs
