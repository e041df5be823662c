#include "app/compare/compare_summary.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <optional>
#include <string>
#include <utility>

#include "app/compare/chance.h"
#include "app/compare/compare_verdict.h"
#include "core/check.h"

namespace b3dgs {
namespace {

using Json = nlohmann::ordered_json;
using Histories = std::vector<ConfigurationHistory>;

Json or_null(const std::optional<double>& value) {
  return value ? Json(*value) : Json(nullptr);
}

// --- Time

/// Returns the training time up to `iteration`, s, linearly interpolated between log lines, and constant after the last
/// line.
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

double seconds_between(const TrainHistory& history, int from, int until) {
  return elapsed_at(history, until) - elapsed_at(history, from);
}

/// Compares the iterations from + 1 to until, which both runs have done. Returns nullopt if `before` took no time for
/// them.
std::optional<double> saved_between(const TrainHistory& before, const TrainHistory& after, int from, int until) {
  const double before_s = seconds_between(before, from, until);
  if (before_s <= 0 || std::min(before.last_iteration(), after.last_iteration()) < until) return std::nullopt;
  return (before_s - seconds_between(after, from, until)) / before_s;
}

/// The iterations over which times are compared.
struct TimedIterations {
  std::vector<int> by_seed;  // common_iterations()
  int chunk = 0;             // iterations per turn
};

/// Returns the largest difference in time between the two trainings of the baseline, as a share, over all seeds.
std::optional<double> repetition_noise(const ConfigurationHistory& baseline, const ConfigurationHistory* repetition,
                                       const TimedIterations& timed) {
  std::optional<double> noise;
  for (std::size_t seed = 0; repetition != nullptr && seed < timed.by_seed.size(); ++seed) {
    const auto saved = saved_between(baseline.by_seed[seed], repetition->by_seed[seed], 0, timed.by_seed[seed]);
    if (saved) noise = std::max(noise, std::optional(std::fabs(*saved)));
  }
  return noise;
}

/// Adds the times of two runs in each turn of `chunk` iterations. Turns end at the first line of the log after them.
void add_turns(TurnTimes& turns, const TrainHistory& before, const TrainHistory& after, int until, int chunk) {
  int from = 0;
  for (const LogPoint& point : before.points) {
    if (point.iteration > until) break;
    if (point.iteration / chunk == from / chunk && point.iteration < until) continue;
    turns.before_s.push_back(seconds_between(before, from, point.iteration));
    turns.after_s.push_back(seconds_between(after, from, point.iteration));
    from = point.iteration;
  }
}

/// Returns the limits for the share of time that `ours` saved.
EffectLimits time_limits(const ConfigurationHistory& baseline, const ConfigurationHistory& ours,
                         const TimedIterations& timed, const std::optional<double>& noise) {
  TurnTimes turns;
  for (std::size_t seed = 0; seed < timed.by_seed.size(); ++seed) {
    add_turns(turns, baseline.by_seed[seed], ours.by_seed[seed], timed.by_seed[seed], timed.chunk);
  }
  EffectLimits limits = limits_of(kTime, noise);
  limits.margin = turns.margin();
  limits.is_too_short = turns.are_too_short();
  return limits;
}

std::optional<int> first_kernel_switch(const TrainHistory& history) {
  for (const Json& check : history.events["kernel_check"]) {
    if (switches_kernel(check)) return check["iteration"].get<int>();
  }
  return std::nullopt;
}

/// Returns the share of time that `after` saved in the iterations of each seed that all configurations have done.
Json saved_overall(const ConfigurationHistory& before, const ConfigurationHistory& after, const TimedIterations& timed,
                   const std::optional<double>& noise) {
  std::vector<double> shares;
  for (std::size_t seed = 0; seed < timed.by_seed.size(); ++seed) {
    const auto saved = saved_between(before.by_seed[seed], after.by_seed[seed], 0, timed.by_seed[seed]);
    if (saved) shares.push_back(*saved);
  }
  return effect_of(shares, time_limits(before, after, timed, noise));
}

/// Compares one configuration with another, over the iterations of each seed that all configurations have done.
Json compare_times(const ConfigurationHistory& baseline, const ConfigurationHistory& ours, const TimedIterations& timed,
                   const std::optional<double>& noise) {
  std::vector<double> before, after, switches;
  Json by_seed = Json::array();
  for (std::size_t seed = 0; seed < timed.by_seed.size(); ++seed) {
    const TrainHistory &base = baseline.by_seed[seed], &own = ours.by_seed[seed];
    const int until = timed.by_seed[seed];
    if (!saved_between(base, own, 0, until)) continue;
    by_seed.push_back({{"until", until}, {"baseline_s", elapsed_at(base, until)}, {"ours_s", elapsed_at(own, until)}});
    const std::optional<int> at = first_kernel_switch(own);
    if (!at) continue;
    switches.push_back(*at);
    const auto saved_before = saved_between(base, own, 0, *at - 1),
               saved_after = saved_between(base, own, *at - 1, until);
    if (*at >= until || !saved_before || !saved_after) continue;
    before.push_back(*saved_before);
    after.push_back(*saved_after);
  }
  return {{"name", ours.name},
          {"baseline", baseline.name},
          {"saved_overall", saved_overall(baseline, ours, timed, noise)},
          {"saved_before_inflection", spread_of(before)},
          {"saved_after_inflection", spread_of(after)},
          {"inflection", spread_of(switches)},
          {"by_seed", by_seed}};
}

// --- Load balancing

/// Returns whether the kernel is load-balanced, or chosen by timing, so that it may be.
bool may_balance(const ConfigurationHistory& configuration) {
  return chooses_kernel(configuration.config) || is_balanced_kernel(configuration.config.kernel);
}

/// Returns the kernels without load balancing that a configuration is compared with: naive, the baseline of the paper,
/// and the best one in the family of the configuration's kernels.
std::array<std::string_view, 2> unbalanced_kernels(const TrainConfig& config) {
  const std::optional<ForwardKernel> fixed = find_kernel(config.kernel);
  const bool is_of_paper = fixed ? family_of(*fixed) == KernelFamily::kPaper : config.kernel == kPublishedKernel;
  return {kernel_name(ForwardKernel::kNaive),
          kernel_name(is_of_paper ? ForwardKernel::kSharedMemory : ForwardKernel::kSubTile)};
}

/// Returns the first configuration with this fixed kernel that differs from `ours` only in the kernel, or null.
const ConfigurationHistory* find_trained(const Histories& configurations, const TrainConfig& ours,
                                         std::string_view kernel) {
  const auto found = std::find_if(configurations.begin(), configurations.end(), [&](const ConfigurationHistory& own) {
    return own.config.kernel == kernel && differing_options(own.config, ours).others.empty();
  });
  return found == configurations.end() ? nullptr : &*found;
}

/// Returns the time that load balancing alone saves: relative to the fastest kernel without it, between configurations
/// that differ in nothing but the kernel. Returns null if the configuration does not balance, or if not every kernel
/// without load balancing was trained with its options.
Json balancing_gain(const Histories& configurations, const ConfigurationHistory& ours, const TimedIterations& timed,
                    const std::optional<double>& noise) {
  if (!may_balance(ours)) return nullptr;
  const auto seconds_of = [&](const ConfigurationHistory& own) {
    double seconds = 0;
    for (std::size_t seed = 0; seed < timed.by_seed.size(); ++seed) {
      seconds += elapsed_at(own.by_seed[seed], timed.by_seed[seed]);
    }
    return seconds;
  };
  const ConfigurationHistory* fastest = nullptr;
  for (const std::string_view kernel : unbalanced_kernels(ours.config)) {
    const ConfigurationHistory* own = find_trained(configurations, ours.config, kernel);
    if (own == nullptr) return nullptr;
    if (fastest == nullptr || seconds_of(*own) < seconds_of(*fastest)) fastest = own;
  }
  const Json saved = saved_overall(*fastest, ours, timed, noise);
  if (saved.is_null()) return nullptr;
  return {{"name", ours.name}, {"unbalanced", fastest->name}, {"saved_by_balancing", saved}};
}

/// Returns whether the two are the comparison in the Balanced 3DGS paper (arXiv 2412.17378): naive against the choice
/// between combined and shared-memory.
bool is_paper_pair(const TrainConfig& baseline, const TrainConfig& ours) {
  return baseline.kernel == kernel_name(ForwardKernel::kNaive) && ours.kernel == kPublishedKernel &&
         differing_options(baseline, ours).others.empty();
}

// --- Quality

std::optional<double> count_of(const LogPoint& point) {
  return point.count ? std::optional(static_cast<double>(*point.count)) : std::nullopt;
}

struct QualityMeasure {
  const char* name;
  Measure measure;
  bool is_relative;  // differences are judged as shares of the baseline's value
  std::optional<double> (*value)(const LogPoint& point);
};

constexpr QualityMeasure kMeasures[] = {
    {kPsnrMeasure, kPsnr, false, [](const LogPoint& point) { return point.test_psnr; }},
    {kSsimMeasure, kSsim, false, [](const LogPoint& point) { return point.test_ssim; }},
    {kCountMeasure, kCount, true, count_of},
};

/// Returns nothing if it was not measured after this iteration.
std::optional<double> value_at(const TrainHistory& history, int iteration, const QualityMeasure& measure) {
  const auto point = std::lower_bound(history.points.begin(), history.points.end(), iteration,
                                      [](const LogPoint& own, int wanted) { return own.iteration < wanted; });
  const bool is_logged = point != history.points.end() && point->iteration == iteration;
  return is_logged ? measure.value(*point) : std::nullopt;
}

/// Returns the last iteration at which all configurations were measured for some seed (0 if there is none), and these
/// seeds.
std::pair<int, std::vector<std::size_t>> common_measurement(const Histories& configurations,
                                                            const QualityMeasure& measure) {
  std::pair<int, std::vector<std::size_t>> common;
  for (std::size_t seed = 0; seed < configurations[0].by_seed.size(); ++seed) {
    const std::vector<LogPoint>& points = configurations[0].by_seed[seed].points;
    const auto last = std::find_if(points.rbegin(), points.rend(), [&](const LogPoint& point) {
      return std::all_of(configurations.begin(), configurations.end(), [&](const ConfigurationHistory& own) {
        return value_at(own.by_seed[seed], point.iteration, measure).has_value();
      });
    });
    if (last == points.rend()) continue;
    if (last->iteration > common.first) common = {last->iteration, {}};
    if (last->iteration == common.first) common.second.push_back(seed);
  }
  return common;
}

/// Compares `ours` with the first configuration at an iteration that all have reached. `repetition` is the second
/// training of the first configuration, or null.
Json compare_quality(const Histories& configurations, const ConfigurationHistory& ours,
                     const ConfigurationHistory* repetition) {
  Json compared = Json::array();
  for (const QualityMeasure& measure : kMeasures) {
    const auto [iteration, seeds] = common_measurement(configurations, measure);
    if (seeds.empty()) continue;
    std::vector<double> before, after, gained;
    std::optional<double> noise;
    for (const std::size_t seed : seeds) {
      const auto value = [&, at = iteration](const ConfigurationHistory& own) {
        return value_at(own.by_seed[seed], at, measure).value();
      };
      before.push_back(value(configurations[0]));
      after.push_back(value(ours));
      gained.push_back(after.back() - before.back());
      if (repetition == nullptr) continue;
      noise = std::max(noise, std::optional(std::fabs(value(*repetition) - before.back())));
    }
    const Json baseline = spread_of(before);
    const double unit = measure.is_relative ? baseline["mean"].get<double>() : 1;
    const auto [floor, one_seed, with_noise] = measure.measure;
    const Json effect = effect_of(gained, limits_of({floor * unit, one_seed * unit, with_noise * unit}, noise));
    compared.push_back({{"measure", measure.name},
                        {"iteration", iteration},
                        {"baseline", baseline},
                        {"ours", spread_of(after)},
                        {"difference", effect["mean"]},
                        {"interval", effect["interval"]},
                        {"finding", effect["finding"]},
                        {"tolerance", effect["limit"]}});
  }
  return compared;
}

/// Returns the results of each configuration at the end of its own training, over the seeds trained so far.
Json final_results(const Histories& configurations, const ConfigurationHistory* repetition) {
  Json results = Json::array();
  const auto is_complete = [](const ConfigurationHistory& own, std::size_t seed) {
    return own.by_seed[seed].last_iteration() >= own.config.iterations && !own.by_seed[seed].points.empty();
  };
  const auto psnr_gained = [&](const ConfigurationHistory& own) {  // over the seeds that have both
    std::vector<double> gained;
    for (std::size_t seed = 0; seed < own.by_seed.size(); ++seed) {
      if (!is_complete(own, seed) || !is_complete(configurations[0], seed)) continue;
      const std::optional<double>&after = own.by_seed[seed].points.back().test_psnr,
            &before = configurations[0].by_seed[seed].points.back().test_psnr;
      if (after && before) gained.push_back(*after - *before);
    }
    return gained;
  };
  std::optional<double> noise;
  if (repetition != nullptr) {
    for (const double own : psnr_gained(*repetition)) noise = std::max(noise, std::optional(std::fabs(own)));
  }
  for (const ConfigurationHistory& own : configurations) {
    std::vector<double> seconds, count, psnr, ssim;
    const auto add = [](std::vector<double>& values, const std::optional<double>& value) {
      if (value) values.push_back(*value);
    };
    for (std::size_t seed = 0; seed < own.by_seed.size(); ++seed) {
      if (!is_complete(own, seed)) continue;
      const LogPoint& last = own.by_seed[seed].points.back();
      seconds.push_back(last.elapsed_s);
      add(count, count_of(last));
      add(psnr, last.test_psnr);
      add(ssim, last.test_ssim);
    }
    results.push_back({{"name", own.name},
                       {"iterations", own.config.iterations},
                       {"complete_seeds", seconds.size()},
                       {"seconds", spread_of(seconds)},
                       {"gaussians", spread_of(count)},
                       {"psnr", spread_of(psnr)},
                       {"ssim", spread_of(ssim)},
                       {"psnr_gained", effect_of(psnr_gained(own), limits_of(kPsnr, noise))}});
  }
  return results;
}

/// Returns the iterations that all configurations have completed, by seed. It is 0 for seeds that have not reached the
/// iteration of another seed, because times over different iterations cannot be averaged.
std::vector<int> common_iterations(const Histories& configurations, int requested) {
  std::vector<int> done(configurations[0].by_seed.size(), requested);
  for (const ConfigurationHistory& configuration : configurations) {
    B3DGS_CHECK(configuration.by_seed.size() == done.size(), configuration.name, " has ", configuration.by_seed.size(),
                " seeds, ", configurations[0].name, " has ", done.size());
    for (std::size_t seed = 0; seed < done.size(); ++seed) {
      done[seed] = std::min(done[seed], configuration.by_seed[seed].last_iteration());
    }
  }
  const int most = *std::max_element(done.begin(), done.end());
  for (int& own : done) own = own < most ? 0 : own;
  return done;
}

/// Returns the subject of the verdict: the first adaptive configuration after the baseline, else the first that may use
/// a load-balanced kernel, else the second.
const ConfigurationHistory& choose_ours(const Histories& configurations) {
  const auto is_adaptive = [](const ConfigurationHistory& own) { return own.config.kernel == kAdaptive; };
  auto ours = std::find_if(configurations.begin() + 1, configurations.end(), is_adaptive);
  if (ours == configurations.end()) ours = std::find_if(configurations.begin() + 1, configurations.end(), may_balance);
  return ours == configurations.end() ? configurations[1] : *ours;
}

}  // namespace

Json summarize_comparison(const Histories& configurations, int iterations, int chunk) {
  B3DGS_CHECK(configurations.size() >= 2, configurations.size(), " configurations");
  B3DGS_CHECK(chunk > 0, chunk, " iterations per turn");
  const ConfigurationHistory &baseline = configurations[0], &ours = choose_ours(configurations);
  const auto again = std::find_if(configurations.begin() + 1, configurations.end(), [&](const auto& own) {
    return differing_options(baseline.config, own.config).empty();
  });
  const ConfigurationHistory* const repetition = again == configurations.end() ? nullptr : &*again;
  const TimedIterations timed{common_iterations(configurations, iterations), chunk};
  const std::optional<double> noise = repetition_noise(baseline, repetition, timed);

  Json compared = Json::array(), balancing = Json::array(), paper_pairs = Json::array();
  for (std::size_t i = 1; i < configurations.size(); ++i) {
    Json& own = compared.emplace_back(compare_times(baseline, configurations[i], timed, noise));
    own["quality"] = compare_quality(configurations, configurations[i], repetition);
  }
  for (const ConfigurationHistory& own : configurations) {
    const Json gain = balancing_gain(configurations, own, timed, noise);
    if (!gain.is_null()) balancing.push_back(gain);
    for (const ConfigurationHistory& other : configurations) {
      if (is_paper_pair(own.config, other.config)) paper_pairs.push_back(compare_times(own, other, timed, noise));
    }
  }
  Json summary{{"verdict", ""},
               {"baseline", baseline.name},
               {"ours", ours.name},
               {"repetition", repetition == nullptr ? "" : repetition->name},
               {"machine_spread", or_null(noise)},
               {"holds_out_views", baseline.config.eval},
               {"iterations", iterations},
               {"done", *std::max_element(timed.by_seed.begin(), timed.by_seed.end())},
               {"done_by_seed", timed.by_seed},
               {"results", final_results(configurations, repetition)},
               {"balancing", balancing},
               {"beside_paper", paper_pairs},
               {"compared", compared}};
  summary["verdict"] = verdict(summary);
  return summary;
}

bool have_equal_lengths(const Json& summary) {
  const Json& results = summary["results"];
  return std::all_of(results.begin(), results.end(),
                     [&](const Json& own) { return own["iterations"] == results[0]["iterations"]; });
}

}  // namespace b3dgs
