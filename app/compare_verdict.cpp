#include "app/compare_verdict.h"

#include <algorithm>
#include <cmath>
#include <set>

#include "app/print.h"
#include "app/svg_axis.h"

namespace b3dgs {
namespace {

/// "adaptive 81.7 s, naive 100.0 s", means over seeds.
std::string both_times(const std::string& baseline, const ComparedConfiguration& ours) {
  double baseline_s = 0, ours_s = 0;
  for (const SavedTime& saved : ours.by_seed) {
    baseline_s += saved.baseline_s / static_cast<double>(ours.by_seed.size());
    ours_s += saved.ours_s / static_cast<double>(ours.by_seed.size());
  }
  const double smaller = std::min(baseline_s, ours_s);
  return ours.name + " " + format_seconds(ours_s, smaller) + ", " + baseline + " " +
         format_seconds(baseline_s, smaller);
}

std::string listed(const std::set<std::string>& names) {
  std::string text;
  for (const std::string& name : names) text += (text.empty() ? "" : " and ") + name;
  return text;
}

bool makes_difference(double saved) {
  return std::fabs(saved) >= kNoDifference;
}

/// "saved 9.4 % of the training time", "took 3.0 % longer", "made no difference beyond 1 %".
std::string what_it_did(double saved, const std::string& of_what = "") {
  if (!makes_difference(saved)) return "made no difference beyond " + format_whole_percent(kNoDifference);
  return saved > 0 ? "saved " + format_percent(saved) + of_what : "took " + format_percent(-saved) + " longer";
}

/// "2000", or "1000 to 2000" where the seeds differ.
std::string iterations_text(const Spread& iterations) {
  const std::string least = std::to_string(std::llround(iterations.min));
  return iterations.range() == 0 ? least : least + " to " + std::to_string(std::llround(iterations.max));
}

/// The verdict where a balanced kernel, or the choice between some, stands against naive.
std::string balancing_verdict(const ComparedConfiguration& ours) {
  int until = 0;
  for (const SavedTime& seed : ours.by_seed) until = std::max(until, seed.until);
  const std::string overall = ours.name + " " + what_it_did(ours.overall->mean, " of the training time");
  if (!ours.balanced.saved) {
    const std::string names = listed(ours.others.kernels);
    return "Balancing did not pay on this scene: " +
           (ours.was_slower_from_start ? names + " was faster from the start" : "no balanced kernel was in use") +
           "; with " + (ours.was_slower_from_start ? "it " : names + " ") + overall;
  }
  const double saved = ours.balanced.saved->mean;
  const bool pays = saved >= kNoDifference;
  if (!ours.others.saved) {
    return (pays ? "Balancing " : "Balancing did not pay on this scene: it ") +
           what_it_did(saved, " of the training time on this scene");
  }
  return (pays ? "Balancing " : "Balancing did not pay on this scene: it ") + what_it_did(saved) + " in the " +
         iterations_text(*ours.balanced.iterations) + " of " + std::to_string(until) + " iterations that " +
         listed(ours.balanced.kernels) + " did" +
         in_seeds(ours.balanced.saved->n, static_cast<int>(ours.by_seed.size())) + "; " + listed(ours.others.kernels) +
         " " + what_it_did(ours.others.saved->mean) + " in the others; overall " + overall;
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

std::string verdict(const ComparisonSummary& summary) {
  const ComparedConfiguration* ours = summary.find(summary.ours);
  if (ours == nullptr || !ours->overall) return "Nothing can be said yet: not every configuration has been trained.";
  std::string text;
  const bool is_kernel_known = ours->balanced.saved || ours->others.saved;
  if (summary.is_balancing && is_kernel_known) {
    text = balancing_verdict(*ours);
  } else if (makes_difference(ours->overall->mean)) {
    text = ours->name + " " + what_it_did(ours->overall->mean, " of the training time of " + summary.baseline);
    if (ours->overall->mean < 0) text += " than " + summary.baseline;
  } else {
    text =
        ours->name + " and " + summary.baseline + " take the same time within " + format_whole_percent(kNoDifference);
  }
  text += " (" + both_times(summary.baseline, *ours) + ")";
  if (ours->overall->min < 0 && ours->overall->max > 0 && ours->overall->range() >= kNoDifference) {
    text += "; the seeds disagree, from " + format_percent(ours->overall->min) + " to " +
            format_percent(ours->overall->max);
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
