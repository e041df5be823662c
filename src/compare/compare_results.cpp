#include "compare/compare_results.h"

#include <algorithm>
#include <cmath>
#include <iterator>

#include "compare/compare_config.h"
#include "core/text.h"

namespace b3dgs {
namespace {

std::string number(double value, int digits) {
  return digits == 0 ? format_count(std::llround(value)) : print_to_string("%.*f", digits, value);
}

}  // namespace

std::vector<FinalResult> final_results(const std::vector<ConfigurationHistory>& configurations) {
  std::vector<FinalResult> results;
  const auto is_complete = [](const ConfigurationHistory& own, std::size_t seed) {
    return own.by_seed[seed].last_iteration() >= own.config.iterations && !own.by_seed[seed].points.empty();
  };
  const ConfigurationHistory& baseline = configurations.front();
  for (const ConfigurationHistory& configuration : configurations) {
    FinalResult result;
    result.name = configuration.name;
    result.iterations = configuration.config.iterations;
    std::vector<double> seconds, count, psnr, ssim, psnr_gained;
    for (std::size_t seed = 0; seed < configuration.by_seed.size(); ++seed) {
      if (!is_complete(configuration, seed)) continue;
      const LogPoint& last = configuration.by_seed[seed].points.back();
      ++result.n_complete;
      seconds.push_back(last.elapsed_s);
      if (last.count) count.push_back(static_cast<double>(*last.count));
      if (last.test_psnr) psnr.push_back(*last.test_psnr);
      if (last.test_ssim) ssim.push_back(*last.test_ssim);
      if (!is_complete(baseline, seed)) continue;
      const std::optional<double>& of_baseline = baseline.by_seed[seed].points.back().test_psnr;
      if (last.test_psnr && of_baseline) psnr_gained.push_back(*last.test_psnr - *of_baseline);
    }
    result.seconds = spread_of(seconds);
    result.count = spread_of(count);
    result.psnr = spread_of(psnr);
    result.ssim = spread_of(ssim);
    result.psnr_gained = effect_of(psnr_gained, kPsnrLimits);
    results.push_back(result);
  }
  return results;
}

bool have_equal_lengths(const std::vector<FinalResult>& results) {
  return std::all_of(results.begin(), results.end(),
                     [&](const FinalResult& own) { return own.iterations == results.front().iterations; });
}

std::string text_table(const std::vector<std::vector<std::string>>& rows) {
  std::vector<std::size_t> widths(rows.front().size());
  for (const std::vector<std::string>& row : rows) {
    for (std::size_t i = 0; i < row.size(); ++i) widths[i] = std::max(widths[i], row[i].size());
  }
  std::string text;
  for (const std::vector<std::string>& row : rows) {
    for (std::size_t i = 0; i < row.size(); ++i) {
      const std::string padding(widths[i] - row[i].size(), ' ');
      text += i == 0 ? row[i] + padding : "  " + padding + row[i];
    }
    text += "\n";
  }
  return text;
}

std::string results_table(const std::vector<FinalResult>& results) {
  std::vector<std::vector<std::string>> rows{
      {"at the end of", "iterations", "training s", "Gaussians", "PSNR dB", "SSIM"}};
  const auto mean = [](const std::optional<Spread>& spread, int digits) {
    return spread ? number(spread->mean, digits) : std::string("-");
  };
  for (const FinalResult& own : results) {
    rows.push_back({own.name, format_count(own.iterations), mean(own.seconds, 2), mean(own.count, 0), mean(own.psnr, 2),
                    mean(own.ssim, 4)});
  }
  return text_table(rows);
}

std::string describe_results(const std::vector<FinalResult>& results) {
  std::string text;
  for (const FinalResult& own : results) {
    if (!own.seconds) continue;
    text += (text.empty() ? "" : "; ") + own.name + print_to_string(" %.1f s", own.seconds->mean);
    if (own.psnr) text += print_to_string(", %.2f dB", own.psnr->mean);
    if (own.count) text += ", " + format_count(std::llround(own.count->mean)) + " Gaussians";
  }
  return text;
}

namespace {

/// 97.5 % quantiles of Student's t distribution for 1, 2, ... degrees of freedom.
constexpr double kStudentT[] = {12.706, 4.303, 3.182, 2.776, 2.571, 2.447, 2.365, 2.306, 2.262, 2.228,
                                2.201,  2.179, 2.160, 2.145, 2.131, 2.120, 2.110, 2.101, 2.093, 2.086,
                                2.080,  2.074, 2.069, 2.064, 2.060, 2.056, 2.052, 2.048, 2.045, 2.042};

/// Beyond the table its last value, which is at most 4 % too large.
double student_t(std::size_t degrees_of_freedom) {
  return kStudentT[std::min(degrees_of_freedom, std::size(kStudentT)) - 1];
}

Finding finding_of(const Effect& effect) {
  if (!effect.margin) return std::fabs(effect.mean) > effect.limit ? Finding::kDiffers : Finding::kUnclear;
  if (effect.low() >= -effect.limit && effect.high() <= effect.limit) return Finding::kEqual;
  const bool excludes_zero = effect.low() > 0 || effect.high() < 0;
  return excludes_zero && std::fabs(effect.mean) >= effect.limit ? Finding::kDiffers : Finding::kUnclear;
}

}  // namespace

std::optional<Effect> effect_of(const std::vector<double>& differences, const EffectLimits& limits) {
  const std::optional<Spread> spread = spread_of(differences);
  if (!spread) return std::nullopt;
  Effect effect;
  static_cast<Spread&>(effect) = *spread;
  effect.limit = limits.one_seed;
  if (const std::size_t n = differences.size(); n > 1) {
    double squares = 0;
    for (const double own : differences) squares += (own - spread->mean) * (own - spread->mean);
    const double standard_error = std::sqrt(squares / static_cast<double>(n - 1) / static_cast<double>(n));
    effect.margin = student_t(n - 1) * standard_error;
    effect.limit = limits.floor;
  }
  effect.finding = finding_of(effect);
  return effect;
}

double limit_with_noise(double noise) {
  return student_t(1) * noise;
}

EffectLimits time_limits(const std::optional<double>& noise) {
  if (!noise) return kTimeLimits;
  return {kTimeLimits.floor, std::max(kTimeLimits.floor, limit_with_noise(*noise))};
}

std::string finding_word(const Effect& effect, const std::string& differs) {
  return effect.differs() ? differs : effect.finding == Finding::kEqual ? "equal" : "unclear";
}

std::string time_word(const Effect& saved) {
  return finding_word(saved, saved.mean > 0 ? "faster" : "slower");
}

std::string interval_text(const Effect& share) {
  return share.margin ? print_to_string("%.1f to %.1f %%", 100 * share.low(), 100 * share.high()) : "";
}

namespace {

double seconds_between(const TrainHistory& history, int from, int until) {
  return elapsed_at(history, until) - elapsed_at(history, from);
}

/// Over the iterations from + 1 to until; nullopt if `before` took no time for them.
std::optional<double> saved_between(const TrainHistory& before, const TrainHistory& after, int from, int until) {
  const double before_s = seconds_between(before, from, until);
  return before_s > 0 ? std::optional(saved_share(before_s, seconds_between(after, from, until))) : std::nullopt;
}

std::optional<double> run_to_run_variation(const RepeatedRun* repeated, int from, int until) {
  if (repeated == nullptr || std::min(repeated->first.last_iteration(), repeated->second.last_iteration()) < until) {
    return std::nullopt;
  }
  const std::optional<double> saved = saved_between(repeated->first, repeated->second, from, until);
  return saved ? std::optional(std::fabs(*saved)) : std::nullopt;
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
                                    const RepeatedRun* repeated) {
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
    saved.before = saved_between(baseline, ours, 0, last_before);
    saved.after = saved_between(baseline, ours, last_before, saved.until);
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

namespace {

/// The first configuration with this fixed kernel that differs from `ours` only in the forward kernel, or null.
const ConfigurationHistory* find_kernel(const std::vector<ConfigurationHistory>& configurations,
                                        const TrainConfig& ours, std::string_view kernel) {
  const auto found = std::find_if(configurations.begin(), configurations.end(), [&](const ConfigurationHistory& own) {
    return own.config.kernel == kernel && differing_options(own.config, ours).others.empty();
  });
  return found == configurations.end() ? nullptr : &*found;
}

std::vector<double> seconds_of(const ConfigurationHistory& configuration, const std::vector<int>& done_by_seed) {
  std::vector<double> seconds;
  for (std::size_t seed = 0; seed < done_by_seed.size(); ++seed) {
    if (done_by_seed[seed] > 0) seconds.push_back(elapsed_at(configuration.by_seed[seed], done_by_seed[seed]));
  }
  return seconds;
}

Effect saved_by_seed(const std::vector<double>& before_s, const std::vector<double>& after_s,
                     const EffectLimits& limits) {
  std::vector<double> saved;
  for (std::size_t i = 0; i < before_s.size(); ++i) saved.push_back(saved_share(before_s[i], after_s[i]));
  return *effect_of(saved, limits);
}

}  // namespace

bool may_balance(const TrainConfig& config) {
  const std::vector<std::string> kernels = forward_candidates(config);
  return std::any_of(kernels.begin(), kernels.end(), [](const std::string& name) { return is_balanced_kernel(name); });
}

std::vector<std::string> missing_unbalanced_kernels(const std::vector<ConfigurationHistory>& configurations,
                                                    const TrainConfig& ours) {
  std::vector<std::string> missing;
  for (const ForwardKernelName& row : kForwardKernels) {
    if (!row.is_balanced && find_kernel(configurations, ours, row.name) == nullptr) missing.emplace_back(row.name);
  }
  return missing;
}

std::optional<BalancingGain> balancing_gain(const std::vector<ConfigurationHistory>& configurations, std::size_t index,
                                            const std::vector<int>& done_by_seed, const std::optional<double>& noise) {
  const ConfigurationHistory& ours = configurations[index];
  if (!may_balance(ours.config) || !missing_unbalanced_kernels(configurations, ours.config).empty()) {
    return std::nullopt;
  }
  const std::vector<double> ours_s = seconds_of(ours, done_by_seed);
  if (ours_s.empty()) return std::nullopt;
  std::vector<double> naive_s, unbalanced_s;
  BalancingGain gain;
  gain.name = ours.name;
  for (const ForwardKernelName& row : kForwardKernels) {
    if (row.is_balanced) continue;
    const ConfigurationHistory& own = *find_kernel(configurations, ours.config, row.name);
    const std::vector<double> own_s = seconds_of(own, done_by_seed);
    if (*std::min_element(own_s.begin(), own_s.end()) <= 0) return std::nullopt;
    if (row.kernel == ForwardKernel::kNaive) {
      naive_s = own_s;
      gain.naive = own.name;
    }
    if (!unbalanced_s.empty() && spread_of(own_s)->mean >= spread_of(unbalanced_s)->mean) continue;
    unbalanced_s = own_s;
    gain.unbalanced = own.name;
  }
  gain.ours_s = spread_of(ours_s)->mean;
  gain.naive_s = spread_of(naive_s)->mean;
  gain.unbalanced_s = spread_of(unbalanced_s)->mean;
  const EffectLimits limits = time_limits(noise);
  gain.to_unbalanced = saved_by_seed(naive_s, unbalanced_s, limits);
  gain.balancing = saved_by_seed(unbalanced_s, ours_s, limits);
  gain.whole = saved_by_seed(naive_s, ours_s, limits);
  return gain;
}

bool is_paper_pair(const TrainConfig& baseline, const TrainConfig& ours) {
  TrainConfig published = ours;
  published.kernel = kPublishedKernel;
  return baseline.kernel == kernel_name(ForwardKernel::kNaive) &&
         baseline.backward_kernel == kernel_name(BackwardKernel::kPerPixel) && chooses_forward_kernel(ours) &&
         forward_candidates(ours) == forward_candidates(published) && differing_options(baseline, ours).others.empty();
}

}  // namespace b3dgs
