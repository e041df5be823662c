#include "compare/compare_verdict.h"

#include <algorithm>
#include <cmath>
#include <utility>
#include <vector>

#include "core/print.h"
#include "report/svg/svg_axis.h"

namespace b3dgs {
namespace {

double mean_seconds(const ComparedConfiguration& ours, double TimeSaved::*seconds) {
  double sum = 0;
  for (const TimeSaved& saved : ours.by_seed) sum += saved.*seconds;
  return sum / static_cast<double>(ours.by_seed.size());
}

/// "adaptive 81.7 s, naive 100.0 s", means over seeds.
std::string times_text(const std::vector<std::pair<std::string, double>>& times) {
  double smallest = times.front().second;
  for (const auto& [name, seconds] : times) smallest = std::min(smallest, seconds);
  std::string text;
  for (const auto& [name, seconds] : times) {
    text += (text.empty() ? "" : ", ") + name + " " + format_seconds(seconds, smallest);
  }
  return text;
}

template <class Names>
std::string listed(const Names& names) {
  std::string text;
  std::size_t left = names.size();
  for (const std::string& name : names) {
    text += name + (left > 2 ? ", " : left == 2 ? " and " : "");
    --left;
  }
  return text;
}

/// "2000", or "1000 to 2000" where the seeds differ.
std::string iterations_text(const Spread& iterations) {
  const std::string least = std::to_string(std::llround(iterations.min));
  return iterations.range() == 0 ? least : least + " to " + std::to_string(std::llround(iterations.max));
}

/// Less than this share is called no difference: a hundredth, or what the machine makes of one and the same.
double no_difference(const ComparisonSummary& summary) {
  return std::max(kNoDifference, summary.noise().value_or(0));
}

/// "saved 9.4 % of the training time of naive", "took 3.0 % longer than naive", "made no difference beyond 1 % to
/// naive".
std::string what_it_did(double saved, const std::string& than, double no_difference) {
  if (std::fabs(saved) < no_difference) {
    return "made no difference beyond " +
           (no_difference > kNoDifference ? format_percent(no_difference) : format_whole_percent(no_difference)) +
           " to " + than;
  }
  return saved > 0 ? "saved " + format_percent(saved) + " of the training time of " + than
                   : "took " + format_percent(-saved) + " longer than " + than;
}

/// ", using combined in 2000 of 4000 iterations"; empty where it used balanced kernels all the time.
std::string used_text(const ComparedConfiguration& ours) {
  if (!ours.others.iterations) return "";
  int until = 0;
  for (const TimeSaved& seed : ours.by_seed) until = std::max(until, seed.until);
  return ", using " + listed(ours.balanced.kernels) + " in " + iterations_text(*ours.balanced.iterations) + " of " +
         std::to_string(until) + " iterations" +
         in_seeds(ours.balanced.iterations->n, static_cast<int>(ours.by_seed.size()));
}

/// Where a balanced kernel was in use and the steps to it are known. Balancing is credited with the last step alone.
std::string balancing_verdict(const ComparedConfiguration& ours, const BalancingGain& steps, double no_difference) {
  const double saved = steps.balancing.mean;
  const bool pays = saved >= no_difference;
  const bool has_two_steps = steps.unbalanced != steps.naive;
  std::string text = pays ? "Balancing " : "Balancing did not pay on this scene: " + ours.name + " ";
  text += what_it_did(saved, steps.unbalanced + ", the best unbalanced kernel", no_difference) + used_text(ours);
  if (has_two_steps) {
    text += "; " + steps.unbalanced + " " + what_it_did(steps.to_unbalanced.mean, steps.naive, no_difference) +
            "; both together: " + format_percent(steps.whole.mean);
  }
  std::vector<std::pair<std::string, double>> times{{ours.name, steps.ours_s.mean}};
  if (has_two_steps) times.emplace_back(steps.unbalanced, steps.unbalanced_s.mean);
  times.emplace_back(steps.naive, steps.naive_s.mean);
  return text + " (" + times_text(times) + ")";
}

/// Where no balanced kernel was in use: what was saved is what the others save.
std::string unbalanced_verdict(const ComparisonSummary& summary, const ComparedConfiguration& ours,
                               const BalancingGain* steps) {
  const std::string names = listed(ours.others.kernels);
  std::string text =
      "Balancing did not pay on this scene: " +
      (ours.was_slower_from_start ? names + " was faster from the start" : "no balanced kernel was in use") +
      "; with " + (ours.was_slower_from_start ? "it " : names + " ") + ours.name + " " +
      what_it_did(ours.overall->mean, summary.baseline, no_difference(summary));
  std::vector<std::pair<std::string, double>> times{{ours.name, mean_seconds(ours, &TimeSaved::ours_s)}};
  if (steps != nullptr && steps->unbalanced != summary.baseline) {
    times.emplace_back(steps->unbalanced, steps->unbalanced_s.mean);
  }
  times.emplace_back(summary.baseline, mean_seconds(ours, &TimeSaved::baseline_s));
  return text + " (" + times_text(times) + ")";
}

/// Of the whole configuration, whatever sets it apart.
std::string configuration_verdict(const ComparisonSummary& summary, const ComparedConfiguration& ours) {
  std::vector<std::string> options = ours.differs_in;
  if (!options.empty() && ours.has_own_kernel) options.insert(options.begin(), "the forward kernel");
  std::string text = (options.empty() ? "" : "The configuration ") + ours.name + " " +
                     what_it_did(ours.overall->mean, summary.baseline, no_difference(summary));
  if (!options.empty()) {
    text += ", from which it differs in " + listed(options);
  } else if (!summary.missing_kernels.empty()) {
    text += "; how much of that is balancing is not known: " + listed(summary.missing_kernels) +
            ", not balanced either, was not trained";
  }
  return text + " (" +
         times_text({{ours.name, mean_seconds(ours, &TimeSaved::ours_s)},
                     {summary.baseline, mean_seconds(ours, &TimeSaved::baseline_s)}}) +
         ")";
}

std::string finding(const ComparisonSummary& summary, const ComparedConfiguration& ours) {
  const BalancingGain* const steps = summary.find_balancing(ours.name);
  const bool is_kernel_known = ours.balanced.iterations || ours.others.iterations;
  if (steps != nullptr && ours.balanced.iterations) {
    const std::string text = balancing_verdict(ours, *steps, no_difference(summary));
    return ours.differs_in.empty() ? text : text + ". " + configuration_verdict(summary, ours);
  }
  const bool could_balance = steps != nullptr || !summary.missing_kernels.empty();
  if (could_balance && is_kernel_known && !ours.balanced.iterations && ours.differs_in.empty()) {
    return unbalanced_verdict(summary, ours, steps);
  }
  return configuration_verdict(summary, ours);
}

}  // namespace

std::string in_seeds(int n, int of) {
  return n == of ? "" : " in " + std::to_string(n) + " of " + std::to_string(of) + " seeds";
}

std::string format_whole_percent(double share) {
  return std::to_string(std::llround(100 * share)) + " %";
}

std::string format_percent(double share) {
  const std::string text = print_to_string("%.1f %%", 100 * share);
  return text == "-0.0 %" ? "0.0 %" : text;
}

std::string format_noise(const std::optional<double>& share) {
  return share ? " +-" + format_percent(*share) : "";
}

std::string describe(const BalancingGain& steps, const std::optional<double>& noise) {
  const auto step = [&](const std::string& from, const std::string& to, const Spread& saved) {
    return from + " to " + to + " " + format_percent(saved.mean) + format_noise(noise);
  };
  const std::string last = step(steps.unbalanced, steps.name + " (balancing)", steps.balancing);
  if (steps.unbalanced == steps.naive) return last + "; no other unbalanced kernel is faster than " + steps.naive;
  return step(steps.naive, steps.unbalanced, steps.to_unbalanced) + ", " + last + ", " +
         step(steps.naive, steps.name, steps.whole);
}

std::string format_quality_difference(const std::string& measure, double difference, bool is_distance) {
  const char* const format = measure == "SSIM" ? "%+.4f" : measure == "Gaussians" ? "%+.0f" : "%+.2f";
  const std::string text = print_to_string(format, difference);
  return is_distance ? text.substr(1) : text;
}

std::string describe_repetition(const ComparisonSummary& summary) {
  const ComparedConfiguration* const own = summary.find(summary.repetition);
  if (own == nullptr || !own->noise.overall) return summary.baseline + " has not been trained twice yet";
  std::string text =
      summary.baseline + " against itself (" + own->name + "): time " + format_percent(*own->noise.overall);
  for (const QualityDifference& difference : own->quality) {
    if (!difference.noise) continue;
    text += ", " + difference.measure.substr(0, difference.measure.find(',')) + " " +
            format_quality_difference(difference.measure, *difference.noise, true);
  }
  return text;
}

std::string verdict(const ComparisonSummary& summary) {
  const ComparedConfiguration* ours = summary.find(summary.ours);
  if (ours == nullptr || !ours->overall) return "Nothing can be said yet: not every configuration has been trained.";
  std::string text = finding(summary, *ours);
  const BalancingGain* const steps = summary.find_balancing(ours->name);
  const Spread& saved = steps != nullptr && ours->balanced.iterations ? steps->balancing : *ours->overall;
  if (saved.min < 0 && saved.max > 0 && saved.range() >= kNoDifference) {
    text += "; the seeds disagree, from " + format_percent(saved.min) + " to " + format_percent(saved.max);
  }
  if (summary.noise()) {
    text += "; " + summary.baseline + " differs from itself by " + format_percent(*summary.noise());
  }
  text += ".";
  const int seeds = static_cast<int>(summary.done_by_seed.size());
  if (summary.done < summary.iterations || summary.seeds_begun() < seeds) {
    text = "Not finished: " + std::to_string(summary.done) + " of " + std::to_string(summary.iterations) +
           " iterations" + (seeds > 1 ? in_seeds(summary.seeds_begun(), seeds) : "") + ". So far: " + text;
  }
  return text;
}

}  // namespace b3dgs
