#include "compare/compare_verdict.h"

#include <algorithm>
#include <cctype>
#include <cmath>
#include <utility>
#include <vector>

#include "core/text.h"
#include "report/page_data.h"

namespace b3dgs {
namespace {

double mean_by_seed(const ComparedConfiguration& ours, double TimeSaved::*seconds) {
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

/// "2000", or "1000 to 2000" if the seeds differ.
std::string iterations_text(const Spread& iterations) {
  const std::string least = std::to_string(std::llround(iterations.min));
  return iterations.range() == 0 ? least : least + " to " + std::to_string(std::llround(iterations.max));
}

/// "saved 9.4 % of the training time of naive", "took 3.0 % longer than naive", "took as long as naive (within 1 %)",
/// "shows no clear difference in training time from naive (time saved: 0.4 %; with one seed, less than 10.0 % may be
/// noise)".
std::string saving_text(const Effect& saved, const std::string& than) {
  const auto percent = [](double low, double high) {
    return print_to_string("95 %% interval %.1f to %.1f %%", 100 * low, 100 * high);
  };
  if (saved.finding == Finding::kEqual) {
    return "took as long as " + than + " (within " + format_whole_percent(saved.limit) + ")";
  }
  if (saved.finding == Finding::kUnclear) {
    return "shows no clear difference in training time from " + than + " (time saved: " + format_percent(saved.mean) +
           (saved.margin ? ", " + percent(saved.low(), saved.high())
                         : "; with one seed, less than " + format_percent(saved.limit) + " may be noise") +
           ")";
  }
  if (saved.mean > 0) {
    return "saved " + format_percent(saved.mean) +
           (saved.margin ? " (" + percent(saved.low(), saved.high()) + ")" : std::string()) +
           " of the training time of " + than;
  }
  return "took " + format_percent(-saved.mean) +
         (saved.margin ? " (" + percent(-saved.high(), -saved.low()) + ")" : std::string()) + " longer than " + than;
}

/// Of what balancing alone saves, to precede saving_text(). `name` is the configuration.
std::string balancing_subject(const Effect& saved, const std::string& name) {
  if (saved.finding == Finding::kUnclear) return "Whether load balancing saves time is not clear: " + name + " ";
  return saved.differs() && saved.mean > 0 ? "Load balancing "
                                           : "Load balancing saved no time on this scene: " + name + " ";
}

/// ", using combined in 2000 of 4000 iterations"; empty if all iterations used load-balanced kernels.
std::string used_text(const ComparedConfiguration& ours) {
  if (!ours.others.iterations) return "";
  int until = 0;
  for (const TimeSaved& seed : ours.by_seed) until = std::max(until, seed.until);
  return ", using " + listed(ours.balanced.kernels) + " in " + iterations_text(*ours.balanced.iterations) + " of " +
         std::to_string(until) + " iterations" +
         in_seeds(ours.balanced.iterations->n, static_cast<int>(ours.by_seed.size()));
}

/// What the fastest kernel without load balancing saves, and what both save together.
std::string whole_saving(const BalancingGain& gain) {
  return "; " + gain.unbalanced + " " + saving_text(gain.to_unbalanced, gain.naive) + "; in total " + gain.name + " " +
         saving_text(gain.whole, gain.naive);
}

/// If a load-balanced kernel was used and its gain is known.
std::string balancing_verdict(const ComparedConfiguration& ours, const BalancingGain& gain) {
  const bool is_naive_fastest = gain.unbalanced == gain.naive;
  std::string text = balancing_subject(gain.balancing, ours.name) +
                     saving_text(gain.balancing, gain.unbalanced + ", the fastest kernel without load balancing") +
                     used_text(ours);
  if (!is_naive_fastest) text += whole_saving(gain);
  std::vector<std::pair<std::string, double>> times{{ours.name, gain.ours_s}};
  if (!is_naive_fastest) times.emplace_back(gain.unbalanced, gain.unbalanced_s);
  times.emplace_back(gain.naive, gain.naive_s);
  return text + " (" + times_text(times) + ")";
}

/// If no load-balanced kernel was used: all savings come from other kernels.
std::string unbalanced_verdict(const ComparisonSummary& summary, const ComparedConfiguration& ours,
                               const BalancingGain* gain) {
  const std::string names = listed(ours.others.kernels);
  std::string text =
      "Load balancing saved no time on this scene: " +
      (ours.was_slower_from_start ? names + " was faster from the start" : "no load-balanced kernel was used") +
      "; with " + (ours.was_slower_from_start ? "it " : names + " ") + ours.name + " " +
      saving_text(*ours.overall, summary.baseline);
  std::vector<std::pair<std::string, double>> times{{ours.name, mean_by_seed(ours, &TimeSaved::ours_s)}};
  if (gain != nullptr && gain->unbalanced != summary.baseline) {
    times.emplace_back(gain->unbalanced, gain->unbalanced_s);
  }
  times.emplace_back(summary.baseline, mean_by_seed(ours, &TimeSaved::baseline_s));
  return text + " (" + times_text(times) + ")";
}

/// "2.20 dB less than naive", "" where that may be chance or configurations learn the same.
std::string quality_lead(const ComparisonSummary& summary, const ComparedConfiguration& ours) {
  const QualityDifference* const psnr = ours.find_quality(kPsnrMeasure);
  if (!ours.learns_differently || psnr == nullptr || !psnr->gained.differs()) return "";
  return print_to_string("reached %.2f dB %s than ", std::fabs(psnr->gained.mean),
                         psnr->gained.mean > 0 ? "more" : "less") +
         summary.baseline + " and ";
}

/// "-2.20 dB", "equal within 0.1 dB", "+0.05 dB, may be chance", with the 95 % interval if that is known.
std::string psnr_text(const Effect& gained) {
  if (gained.finding == Finding::kEqual) return print_to_string("equal within %.3g dB", gained.limit);
  return print_to_string("%+.2f dB", gained.mean) + (gained.differs() ? "" : ", may be chance") +
         (gained.margin ? print_to_string(", 95 %% interval %+.2f to %+.2f", gained.low(), gained.high())
                        : std::string());
}

/// What is not said of one seed.
std::string one_seed_sentence(const Effect& gained) {
  return gained.margin ? "" : print_to_string(" One seed: differences below %.3g dB say nothing.", gained.limit);
}

/// About the configuration as a whole, naming the options in which it differs: of many, as with a preset, the first.
std::string configuration_verdict(const ComparisonSummary& summary, const ComparedConfiguration& ours) {
  std::vector<std::string> options = ours.differs_in;
  if (!options.empty() && ours.has_own_kernel) options.insert(options.begin(), "the forward kernel");
  constexpr std::size_t kMostNamed = 5;
  if (options.size() > kMostNamed + 1) {
    const std::string others = std::to_string(options.size() - kMostNamed) + " more options";
    options.resize(kMostNamed);
    options.push_back(others);
  }
  // What was lost comes before what was saved.
  std::string text = (options.empty() ? "" : "The configuration ") + ours.name + " " + quality_lead(summary, ours) +
                     saving_text(*ours.overall, summary.baseline);
  if (!options.empty()) {
    text += ", from which it differs in " + listed(options);
  } else if (!summary.missing_kernels.empty()) {
    const bool is_one = summary.missing_kernels.size() == 1;
    text += "; the share of load balancing is unknown because " + listed(summary.missing_kernels) +
            (is_one ? ", a kernel without load balancing, was not trained"
                    : ", kernels without load balancing, were not trained");
  }
  return text + " (" +
         times_text({{ours.name, mean_by_seed(ours, &TimeSaved::ours_s)},
                     {summary.baseline, mean_by_seed(ours, &TimeSaved::baseline_s)}}) +
         ")";
}

std::string finding(const ComparisonSummary& summary, const ComparedConfiguration& ours) {
  const BalancingGain* const gain = summary.find_balancing(ours.name);
  const bool is_kernel_known = ours.balanced.iterations || ours.others.iterations;
  if (gain != nullptr && ours.balanced.iterations) {
    const std::string text = balancing_verdict(ours, *gain);
    return ours.differs_in.empty() ? text : text + ". " + configuration_verdict(summary, ours);
  }
  const bool could_balance = gain != nullptr || !summary.missing_kernels.empty();
  if (could_balance && is_kernel_known && !ours.balanced.iterations && ours.differs_in.empty()) {
    return unbalanced_verdict(summary, ours, gain);
  }
  return configuration_verdict(summary, ours);
}

std::string unmeasured_sentence(const ComparisonSummary& summary) {
  return summary.holds_out_views ? " Quality has not been measured yet."
                                 : " No views were held out (--no_eval), so quality was not measured.";
}

/// The same for configurations of different lengths, each at its own end: differences to the baseline.
std::string final_quality_sentence(const ComparisonSummary& summary) {
  const FinalResult& baseline = summary.results.front();
  const auto has_psnr = [](const FinalResult& own) { return own.psnr.has_value(); };
  if (std::none_of(summary.results.begin(), summary.results.end(), has_psnr)) return unmeasured_sentence(summary);
  std::string text, note;
  const int n_seeds = static_cast<int>(summary.done_by_seed.size());
  for (const FinalResult& own : summary.results) {
    if (own.name == baseline.name || !own.psnr_gained) continue;
    text += (text.empty() ? " " : "; ") + own.name + " " + psnr_text(*own.psnr_gained) +
            in_seeds(own.psnr_gained->n, n_seeds);
    note = one_seed_sentence(*own.psnr_gained);
  }
  return text.empty() ? "" : " PSNR of the held-out views, compared with " + baseline.name + ":" + text + "." + note;
}

/// " PSNR of the held-out views: original 28.30 dB, fast 27.10 dB (-1.20 dB).", of all configurations that differ from
/// the baseline in what they learn; "" if none does. The time says little about these without the quality.
std::string quality_sentence(const ComparisonSummary& summary) {
  std::string text;
  const QualityDifference* measured = nullptr;
  bool is_asked = false;
  for (const ComparedConfiguration& own : summary.compared) {
    if (!own.learns_differently) continue;
    is_asked = true;
    const QualityDifference* const psnr = own.find_quality(kPsnrMeasure);
    if (psnr == nullptr) continue;
    measured = psnr;
    text += ", " + own.name + print_to_string(" %.2f dB (", psnr->ours.mean) + psnr_text(psnr->gained) + ")";
  }
  if (!is_asked) return "";
  if (measured == nullptr) return unmeasured_sentence(summary);
  const bool is_at_end = measured->iteration == summary.iterations;
  return " PSNR of the held-out views" +
         (is_at_end ? "" : " after " + std::to_string(measured->iteration) + " iterations") +
         in_seeds(measured->baseline.n, summary.seeds_started()) +
         print_to_string(": %s %.2f dB", summary.baseline.c_str(), measured->baseline.mean) + text + "." +
         one_seed_sentence(measured->gained);
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

std::string time_criterion(const ComparisonSummary& summary) {
  if (summary.seeds_started() > 1) {
    return "95 %: the interval of the mean over the seeds (Student's t). \"Unclear\": it includes 0, or the mean is "
           "below 1 %. \"Equal\": it lies within 1 %.";
  }
  return std::string("With one seed, differences below ") +
         (summary.noise() ? format_percent(time_limits(summary.noise()).one_seed) +
                                ", 12.7 times the run-to-run variation but at least 1 %,"
                          : format_whole_percent(kTimeLimits.one_seed)) +
         " may be noise (\"unclear\"); --seeds 0,1,2 tells more.";
}

std::string describe(const BalancingGain& gain) {
  std::string balancing = balancing_subject(gain.balancing, gain.name) + saving_text(gain.balancing, gain.unbalanced);
  balancing[0] = static_cast<char>(std::tolower(static_cast<unsigned char>(balancing[0])));
  if (gain.unbalanced == gain.naive) {
    return balancing + " (no kernel without load balancing is faster than " + gain.naive + ")";
  }
  return balancing + whole_saving(gain);
}

std::string describe_repetition(const ComparisonSummary& summary) {
  const ComparedConfiguration* const own = summary.find(summary.repetition);
  if (own == nullptr || !own->noise.overall)
    return summary.baseline + " has not been trained twice yet, so the run-to-run variation is unknown";
  std::string text = "run-to-run variation of " + summary.baseline + ": time " + format_percent(*own->noise.overall);
  for (const QualityDifference& difference : own->quality) {
    if (!difference.noise) continue;
    const bool is_ssim = difference.measure == "SSIM", is_count = difference.measure == "Gaussians";
    text += ", " + difference.measure.substr(0, difference.measure.find(',')) + " " +
            print_to_string(is_ssim    ? "%.4f"
                            : is_count ? "%.0f"
                                       : "%.2f",
                            *difference.noise);
  }
  return text;
}

std::string verdict(const ComparisonSummary& summary) {
  if (!have_equal_lengths(summary.results)) {
    // Times over the same iterations say nothing here.
    const std::string text = describe_results(summary.results);
    const int n_seeds = static_cast<int>(summary.done_by_seed.size());
    const bool is_complete = std::all_of(summary.results.begin(), summary.results.end(),
                                         [&](const FinalResult& own) { return own.n_complete == n_seeds; });
    if (text.empty()) return "No result yet: no configuration has been trained to its end.";
    return (is_complete ? "" : "Not finished. So far: ") + text + "." + final_quality_sentence(summary);
  }
  const ComparedConfiguration* ours = summary.find(summary.ours);
  if (ours == nullptr || !ours->overall) return "No result yet: not every configuration has been trained.";
  std::string text = finding(summary, *ours);
  if (summary.noise()) {
    text += "; two runs of " + summary.baseline + " differ by " + format_percent(*summary.noise());
  }
  text += "." + quality_sentence(summary);
  const int seeds = static_cast<int>(summary.done_by_seed.size());
  if (summary.done < summary.iterations || summary.seeds_started() < seeds) {
    text = "Not finished: " + std::to_string(summary.done) + " of " + std::to_string(summary.iterations) +
           " iterations" + (seeds > 1 ? in_seeds(summary.seeds_started(), seeds) : "") + ". So far: " + text;
  }
  return text;
}

}  // namespace b3dgs
