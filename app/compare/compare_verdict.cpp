#include "app/compare/compare_verdict.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <optional>
#include <vector>

#include "app/compare/chance.h"
#include "app/compare/compare_summary.h"
#include "app/report/page_data.h"
#include "core/text.h"

namespace b3dgs {
namespace {

using Json = nlohmann::ordered_json;

std::string percent(double share) {
  const std::string text = print_to_string("%.1f %%", 100 * share);
  return text == "-0.0 %" ? "0.0 %" : text;
}

/// Returns " in 1 of 3 seeds", or "" if n == of.
std::string in_seeds(std::size_t n, std::size_t of) {
  return n == of ? "" : detail::concat(" in ", n, " of ", of, " seeds");
}

std::size_t seeds_started(const Json& summary) {
  const Json& done = summary["done_by_seed"];
  return static_cast<std::size_t>(std::count_if(done.begin(), done.end(), [](const Json& own) { return own > 0; }));
}

bool is_too_short(const Json& saved) {
  return saved["finding"] == "too short";
}

/// Returns "saved 9.4 % of the training time of naive", "took 3.0 % longer than naive", "took as long as naive", "shows
/// no clear difference in training time from naive" or "against naive: too short to judge". Adds in brackets the
/// interval or the limitation of one seed, and `times`.
std::string saving_text(const Json& saved, const std::string& than, const std::string& times = "") {
  const auto in_brackets = [](const std::string& notes) { return notes.empty() ? "" : " (" + notes + ")"; };
  if (is_too_short(saved)) return "against " + than + ": too short to judge the training time" + in_brackets(times);
  const double mean = saved["mean"];
  const bool differs = saved["finding"] == "differs", lost = differs && mean < 0, equal = saved["finding"] == "equal";
  const std::string text = lost      ? "took " + percent(-mean) + " longer than " + than
                           : differs ? "saved " + percent(mean) + " of the training time of " + than
                           : equal   ? "took as long as " + than
                                     : "shows no clear difference in training time from " + than;
  std::string notes = differs || equal ? "" : "time saved: " + percent(mean);
  if (const Json& interval = saved["interval"]; !interval.is_null()) {
    const double low = interval[lost ? 1 : 0], high = interval[lost ? 0 : 1], sign = lost ? -100 : 100;
    notes += (notes.empty() ? "" : ", ") + print_to_string("95 %% interval %.1f to %.1f %%", sign * low, sign * high);
  } else if (!differs && !equal) {
    notes += "; with one seed, less than " + percent(saved["limit"]) + " may be chance";
  }
  if (!times.empty()) notes += (notes.empty() ? "" : "; ") + times;
  return text + in_brackets(notes);
}

/// Returns "; load balancing alone: adaptive saved 20.0 % of the training time of sub-tile, the fastest kernel without
/// it".
std::string balancing_text(const Json& summary, const Json& ours) {
  const bool has_balanced = !ours["balanced_kernels"]["iterations"].is_null();
  const bool is_named = has_balanced || !ours["other_kernels"]["iterations"].is_null();
  const Json &gains = summary["balancing"], &missing = summary["missing_kernels"];
  const auto is_ours = [&](const Json& own) { return own["name"] == ours["name"]; };
  const auto gain = std::find_if(gains.begin(), gains.end(), is_ours);
  if (gain == gains.end() && (missing.empty() || !ours["differs_in"].empty())) return "";
  if (is_named && !has_balanced) return "; load balancing saved no time: no load-balanced kernel was used";
  if (gain != gains.end()) {
    if (is_too_short((*gain)["saved_by_balancing"])) return "; load balancing alone: too short to judge";
    return "; load balancing alone: " + ours["name"].get<std::string>() + " " +
           saving_text((*gain)["saved_by_balancing"], (*gain)["unbalanced"]) + ", the fastest kernel without it";
  }
  return "; what load balancing contributes is unknown, since " + missing[0].get<std::string>() +
         (missing.size() > 1 ? " and others were" : " was") + " not trained";
}

/// Returns one of the measures of "quality"; null if it was not measured.
Json quality_of(const Json& compared, const char* measure) {
  for (const Json& own : compared["quality"]) {
    if (own["measure"] == measure) return own;
  }
  return nullptr;
}

/// Returns the PSNR difference of configuration i from the baseline, at the end of each or at an iteration that all
/// have reached. Returns null if it is unknown.
Json psnr_gained(const Json& summary, std::size_t i) {
  if (!have_equal_lengths(summary)) return summary["results"][i]["psnr_gained"];
  const Json own = quality_of(summary["compared"][i - 1], kPsnrMeasure);
  if (own.is_null()) return nullptr;
  return {{"mean", own["difference"]}, {"interval", own["interval"]}, {"finding", own["finding"]},
          {"limit", own["tolerance"]}, {"n", own["baseline"]["n"]},   {"iteration", own["iteration"]}};
}

/// Returns " PSNR of the test views, compared with naive: fast -2.20 dB, same +0.05 dB (may be chance).", for all
/// configurations that learn differently from the baseline, because their time means little without it. Returns "" if
/// there is none.
std::string psnr_sentence(const Json& summary) {
  const std::size_t n_seeds = summary["done_by_seed"].size();
  const bool is_of_one_length = have_equal_lengths(summary);  // then all were measured in the same seeds
  std::string text;
  Json last, of_one_seed;
  bool is_asked = false;
  for (std::size_t i = 1; i < summary["results"].size(); ++i) {
    if (!summary["compared"][i - 1]["learns_differently"]) continue;
    is_asked = true;
    const Json gained = psnr_gained(summary, i);
    if (gained.is_null()) continue;
    last = gained;
    if (gained["interval"].is_null()) of_one_seed = gained;
    text += (text.empty() ? "" : ", ") + summary["results"][i]["name"].get<std::string>() +
            print_to_string(" %+.2f dB", gained["mean"].get<double>());
    if (const Json& interval = gained["interval"]; !interval.is_null()) {
      text += print_to_string(" (95 %% interval %+.2f to %+.2f)", interval[0].get<double>(), interval[1].get<double>());
    }
    if (!is_of_one_length) text += in_seeds(gained["n"], n_seeds);
    if (gained["finding"] != "differs") text += gained["finding"] == "equal" ? ", so equal" : ", which may be chance";
  }
  if (!is_asked) return "";
  if (text.empty()) {
    return summary["holds_out_views"] ? " Quality has not been measured yet."
                                      : " No views were held out (--no_eval), so quality was not measured.";
  }
  std::string one_seed;
  if (!of_one_seed.is_null()) {
    const double limit = of_one_seed["limit"];
    one_seed = print_to_string(" One seed: differences below %.3g dB may be chance, ", limit) +
               (limit > kPsnr.one_seed ? "judging by two runs of " + summary["baseline"].get<std::string>()
                                       : "assuming that runs vary by at most 0.2 dB") +
               ".";
  }
  const bool is_earlier = last.contains("iteration") && last["iteration"] != summary["iterations"];
  return " PSNR of the test views" + (is_earlier ? " after " + last["iteration"].dump() + " iterations" : "") +
         (is_of_one_length ? in_seeds(last["n"], n_seeds) : "") + ", compared with " +
         summary["baseline"].get<std::string>() + ": " + text + "." + one_seed;
}

/// Returns "inria 38.2 s, 28.90 dB, 931,000 Gaussians; fast 4.9 s, ..." without unknown values.
std::string results_text(const Json& results) {
  std::string text;
  for (const Json& own : results) {
    const auto mean = [&](const char* key) { return own[key]["mean"].get<double>(); };
    if (own["seconds"].is_null()) continue;
    text += (text.empty() ? "" : "; ") + own["name"].get<std::string>() + print_to_string(" %.1f s", mean("seconds"));
    if (!own["psnr"].is_null()) text += print_to_string(", %.2f dB", mean("psnr"));
    if (!own["gaussians"].is_null()) text += ", " + format_count(std::llround(mean("gaussians"))) + " Gaussians";
  }
  return text;
}

/// Returns the mean of "ours_s" or "baseline_s" over seeds; nothing without seeds.
std::optional<double> mean_seconds(const Json& compared, const char* key) {
  const Json& by_seed = compared["by_seed"];
  if (by_seed.empty()) return std::nullopt;
  double sum = 0;
  for (const Json& seed : by_seed) sum += seed[key].get<double>();
  return sum / static_cast<double>(by_seed.size());
}

/// Returns "adaptive 16.0 s, naive 40.0 s", means over at least one seed.
std::string times_text(const Json& ours) {
  const double ours_s = mean_seconds(ours, "ours_s").value(), baseline_s = mean_seconds(ours, "baseline_s").value();
  const double smallest = std::min(ours_s, baseline_s);
  return ours["name"].get<std::string>() + " " + format_seconds(ours_s, smallest) + ", " +
         ours["baseline"].get<std::string>() + " " + format_seconds(baseline_s, smallest);
}

/// Formats aligned columns, the first to the left. Columns with only "-" below the head are left out.
std::string text_table(const std::vector<std::vector<std::string>>& rows) {
  std::vector<std::string> lines(rows.size());
  for (std::size_t column = 0; column < rows.front().size(); ++column) {
    const auto is_empty = [&](const std::vector<std::string>& row) { return row[column] == "-"; };
    if (std::all_of(rows.begin() + 1, rows.end(), is_empty)) continue;
    std::size_t width = 0;
    for (const std::vector<std::string>& row : rows) width = std::max(width, row[column].size());
    for (std::size_t i = 0; i < rows.size(); ++i) {
      const std::string padding(width - rows[i][column].size(), ' ');
      lines[i] += column == 0 ? rows[i][column] + padding : "  " + padding + rows[i][column];
    }
  }
  std::string text;
  for (const std::string& line : lines) text += line + "\n";
  return text;
}

std::optional<double> mean_of(const Json& spread) {
  return spread.is_null() ? std::nullopt : std::optional(spread["mean"].get<double>());
}

/// Returns "-" without a value.
std::string cell(const char* format, const std::optional<double>& value) {
  return value ? print_to_string(format, *value) : "-";
}

}  // namespace

std::string verdict(const Json& summary) {
  const Json& results = summary["results"];
  const std::size_t n_seeds = summary["done_by_seed"].size(), n_started = seeds_started(summary);
  if (!have_equal_lengths(summary)) {
    // Times over the same iterations are not meaningful here.
    const std::string text = results_text(results);
    const bool is_complete =
        std::all_of(results.begin(), results.end(), [&](const Json& own) { return own["complete_seeds"] == n_seeds; });
    if (text.empty()) return "No result yet: no configuration has been trained to its end.";
    return (is_complete ? "" : "Not finished. So far: ") + text + "." + psnr_sentence(summary);
  }
  const Json& compared = summary["compared"];
  const Json& ours =
      *std::find_if(compared.begin(), compared.end(), [&](const Json& own) { return own["name"] == summary["ours"]; });
  if (ours["saved_overall"].is_null()) return "No result yet: not every configuration has been trained.";
  const std::string baseline = summary["baseline"];
  std::string text = ours["name"].get<std::string>() + " " +
                     saving_text(ours["saved_overall"], baseline, times_text(ours)) + balancing_text(summary, ours);
  if (const Json& noise = summary["machine_spread"]; noise.is_number()) {
    text += "; two runs of " + baseline + " differ by " + percent(noise);
  }
  text += ".";
  const Json& saved = ours["saved_overall"];
  if (is_too_short(saved)) {
    text += " Times need at least 10 turns and 10 s of each configuration.";
  } else if (saved["interval"].is_null()) {
    text += " One seed: this assumes that runs differ no more than the spread of their turns suggests.";
  }
  text += psnr_sentence(summary);
  if (summary["done"] == summary["iterations"] && n_started == n_seeds) return text;
  return "Not finished: " + summary["done"].dump() + " of " + summary["iterations"].dump() + " iterations" +
         in_seeds(n_started, n_seeds) + ". So far: " + text;
}

std::string summary_table(const Json& summary) {
  const bool compares_times = have_equal_lengths(summary);
  std::vector<std::vector<std::string>> rows{{compares_times ? "configuration" : "at the end of", "iterations",
                                              "training s", "time saved", "95 % interval", "time", "PSNR dB", "PSNR",
                                              "SSIM", "Gaussians"}};
  for (std::size_t i = 0; i < summary["results"].size(); ++i) {
    const Json &own = summary["results"][i], &compared = summary["compared"][i == 0 ? 0 : i - 1];
    const Json saved = i == 0 || !compares_times ? Json() : compared["saved_overall"];
    const Json gained = i == 0 ? Json() : psnr_gained(summary, i);
    // Trainings need not be complete, so each column covers the iterations and seeds that all have done.
    const auto value = [&](const char* measure, const char* of_result) {
      if (!compares_times) return mean_of(own[of_result]);
      const Json quality = quality_of(compared, measure);
      return quality.is_null() ? std::nullopt : mean_of(quality[i == 0 ? "baseline" : "ours"]);
    };
    const std::optional<double> seconds =
        compares_times ? mean_seconds(compared, i == 0 ? "baseline_s" : "ours_s") : mean_of(own["seconds"]);
    std::string share = "-", interval = "-", finding = "-";
    if (!saved.is_null()) {
      share = percent(saved["mean"]);
      finding = saved["finding"];
      if (finding == "differs") finding = saved["mean"] > 0 ? "faster" : "slower";
      if (const Json& own_interval = saved["interval"]; !own_interval.is_null()) {
        interval = print_to_string("%.1f to ", 100 * own_interval[0].get<double>()) + percent(own_interval[1]);
      }
    }
    const std::string psnr = gained.is_null() ? "-" : gained["finding"].get<std::string>();
    rows.push_back({own["name"], format_count(own["iterations"].get<std::int64_t>()), cell("%.2f", seconds), share,
                    interval, finding, cell("%.2f", value(kPsnrMeasure, "psnr")), psnr,
                    cell("%.4f", value(kSsimMeasure, "ssim")), cell("%.0f", value(kCountMeasure, "gaussians"))});
  }
  return text_table(rows);
}

std::string paper_table(const Json& summary) {
  const Json& pairs = summary["beside_paper"];
  if (pairs.empty()) return "";
  std::vector<std::vector<std::string>> rows{
      {"time saved", "up to the inflection", "from it", "overall", "inflection"}};
  for (const Json& pair : pairs) {
    const auto share = [&](const char* key) {
      const Json& saved = pair[key];
      return saved.is_null() ? "-" : percent(saved["mean"]) + in_seeds(saved["n"], seeds_started(summary));
    };
    std::string before = pair["by_seed"].empty() ? "-" : "no switch", after = before, at = "-";
    if (const Json& inflection = pair["inflection"]; !inflection.is_null()) {
      const auto first = inflection["min"].get<std::int64_t>(), last = inflection["max"].get<std::int64_t>();
      before = share("saved_before_inflection");
      after = share("saved_after_inflection");
      at = format_count(first) + (last > first ? " to " + format_count(last) : "");
    }
    rows.push_back({pair["name"].get<std::string>() + " against " + pair["baseline"].get<std::string>(), before, after,
                    share("saved_overall"), at});
  }
  rows.push_back({"in the paper", "19.6 %", "7.9 %", "8.5 %", "about 2,000"});
  return text_table(rows);
}

}  // namespace b3dgs
