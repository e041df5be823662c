#include "app/compare/compare_verdict.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <optional>

#include "app/compare/chance.h"
#include "app/compare/compare_summary.h"
#include "app/report/page_data.h"
#include "core/text.h"

namespace b3dgs {
namespace {

using Json = nlohmann::ordered_json;
using Cells = std::vector<std::string>;

/// How to write an effect, and the findings of one above and one below 0.
struct Unit {
  double scale;
  const char *format, *name, *gained, *lost;
};
constexpr Unit kShareOfTime{100, "%.1f", " %", "faster", "slower"};
constexpr Unit kDecibels{1, "%+.2f", " dB", "differs", "differs"};

std::string number_text(double value, const Unit& unit) {
  const std::string text = print_to_string(unit.format, unit.scale * value);
  const bool is_zero = text.find_first_of("123456789") == std::string::npos;
  return is_zero ? print_to_string(unit.format, 0.0) : text;  // without the sign of a small negative value
}

std::string mean_text(const Json& spread, const Unit& unit) {
  return number_text(spread["mean"], unit) + unit.name;
}

std::string interval_text(const Json& interval, const Unit& unit) {
  return number_text(interval[0], unit) + " to " + number_text(interval[1], unit) + unit.name;
}

std::string limit_text(const Json& effect, const Unit& unit) {
  return print_to_string("%.3g", unit.scale * effect["limit"].get<double>()) + unit.name;
}

bool is_too_short(const Json& effect) {
  return effect["finding"] == "too short";
}

/// Returns whether an effect is judged by the assumptions of one seed.
bool is_of_one_seed(const Json& effect) {
  return !effect.is_null() && effect["interval"].is_null() && !is_too_short(effect);
}

/// Returns " in 1 of 3 seeds", or "" if n == of.
std::string in_seeds(std::size_t n, std::size_t of) {
  return n == of ? "" : detail::concat(" in ", n, " of ", of, " seeds");
}

std::size_t seeds_started(const Json& summary) {
  const Json& done = summary["done_by_seed"];
  return static_cast<std::size_t>(std::count_if(done.begin(), done.end(), [](const Json& own) { return own > 0; }));
}

/// Returns one of the measures of "quality"; null if it was not measured.
Json quality_of(const Json& compared, const char* measure) {
  for (const Json& own : compared["quality"]) {
    if (own["measure"] == measure) return own;
  }
  return nullptr;
}

/// The differences of a configuration from the baseline; null if unknown.
struct Effects {
  Json saved, psnr;
};

/// Returns the differences over the iterations that all have done. If lengths differ, times are not compared, and PSNR
/// is that at the end of each training.
Effects effects_of(const Json& summary, std::size_t configuration) {
  if (configuration == 0) return {};
  if (!have_equal_lengths(summary)) return {nullptr, summary["results"][configuration]["psnr_gained"]};
  const Json &compared = summary["compared"][configuration - 1], psnr = quality_of(compared, kPsnrMeasure);
  if (psnr.is_null()) return {compared["saved_overall"], nullptr};
  return {compared["saved_overall"],
          {{"mean", psnr["difference"]},
           {"interval", psnr["interval"]},
           {"finding", psnr["finding"]},
           {"limit", psnr["tolerance"]},
           {"n", psnr["baseline"]["n"]},
           {"iteration", psnr["iteration"]}}};
}

// --- The headline

/// Returns the notes on an effect in brackets: `mean`, and the interval or, of one seed, what is assumed.
std::string notes(const Json& effect, const Unit& unit, const std::string& assumption, const std::string& mean = "") {
  const std::string text = " (" + (mean.empty() ? "" : mean + ", ");
  if (!is_of_one_seed(effect)) return text + "95 % interval " + interval_text(effect["interval"], unit) + ")";
  const bool is_unclear = effect["finding"] == "unclear";
  return text + "one seed, " + (is_unclear ? "less than " + limit_text(effect, unit) + " may be chance, " : "") +
         assumption + ")";
}

/// Returns "adaptive saved 9.4 % of the training time of naive (95 % interval 8.9 to 9.9 %)", or another finding.
std::string time_text(const Json& saved, const std::string& ours, const std::string& baseline) {
  if (is_too_short(saved)) {
    return ours + " and " + baseline + " ran for too short a time to compare them (it takes 10 turns and 10 s of each)";
  }
  const std::string assumption = "assuming that runs differ no more than the spread of their turns suggests";
  const std::string mean = mean_text(saved, kShareOfTime);
  const bool differs = saved["finding"] == "differs";
  if (differs && saved["mean"] > 0) {
    return ours + " saved " + mean + " of the training time of " + baseline + notes(saved, kShareOfTime, assumption);
  }
  return ours +
         (differs                       ? " took longer than "
          : saved["finding"] == "equal" ? " took as long as "
                                        : " shows no clear difference in training time from ") +
         baseline + notes(saved, kShareOfTime, assumption, "time saved " + mean);
}

/// Returns "fast took 4.9 s for 2,000 iterations, and inria 38.2 s for 30,000".
std::string lengths_text(const Json& ours, const Json& baseline) {
  const double ours_s = ours["seconds"]["mean"], baseline_s = baseline["seconds"]["mean"];
  const double smallest = std::min(ours_s, baseline_s);
  return ours["name"].get<std::string>() + " took " + format_seconds(ours_s, smallest) + " for " +
         format_count(ours["iterations"]) + " iterations, and " + baseline["name"].get<std::string>() + " " +
         format_seconds(baseline_s, smallest) + " for " + format_count(baseline["iterations"]);
}

/// Returns "the PSNR of fast differs (-2.20 dB, 95 % interval -2.31 to -2.09 dB)", or another finding.
std::string psnr_text(const Json& gained, const Json& summary, std::size_t n_seeds) {
  if (gained.is_null()) {
    return summary["holds_out_views"] ? "quality has not been measured yet"
                                      : "quality was not measured, because no views were held out (--no_eval)";
  }
  const bool is_earlier = gained.contains("iteration") && gained["iteration"] != summary["iterations"];
  const std::string assumption = gained["limit"] > kPsnr.one_seed
                                     ? "judging by two runs of " + summary["baseline"].get<std::string>()
                                     : "assuming that runs vary by at most 0.2 dB";
  return "the PSNR of " + summary["ours"].get<std::string>() +
         (is_earlier ? " after " + format_count(gained["iteration"]) + " iterations" : "") +
         in_seeds(gained["n"], n_seeds) +
         (gained["finding"] == "differs" ? " differs"
          : gained["finding"] == "equal" ? " is equal"
                                         : " shows no clear difference") +
         notes(gained, kDecibels, assumption, mean_text(gained, kDecibels));
}

// --- Tables

constexpr const char *kNone = "-", *kInterval = "95 % interval";

std::optional<double> mean_of(const Json& spread) {
  return spread.is_null() ? std::nullopt : std::optional(spread["mean"].get<double>());
}

std::string cell(const char* format, const std::optional<double>& value) {
  return value ? print_to_string(format, *value) : kNone;
}

/// Returns the mean of "ours_s" or "baseline_s" over seeds.
std::optional<double> mean_seconds(const Json& compared, const char* key) {
  const Json& by_seed = compared["by_seed"];
  if (by_seed.empty()) return std::nullopt;
  double sum = 0;
  for (const Json& seed : by_seed) sum += seed[key].get<double>();
  return sum / static_cast<double>(by_seed.size());
}

/// Adds four cells: the mean, its interval, the limit of one seed, and the finding.
void add_effect(Cells& cells, const Json& effect, const Unit& unit) {
  if (effect.is_null()) {
    cells.insert(cells.end(), 4, kNone);
    return;
  }
  const Json& interval = effect["interval"];
  std::string finding = effect["finding"];
  if (finding == "differs") finding = effect["mean"] > 0 ? unit.gained : unit.lost;
  cells.push_back(mean_text(effect, unit));
  cells.push_back(interval.is_null() ? kNone : interval_text(interval, unit));
  cells.push_back(is_of_one_seed(effect) ? limit_text(effect, unit) : kNone);
  cells.push_back(finding);
}

/// Leaves out the columns that have only "-" below the head.
TextTable without_empty_columns(const TextTable& table) {
  TextTable kept(table.size());
  for (std::size_t column = 0; column < table.front().size(); ++column) {
    const auto is_empty = [&](const Cells& row) { return row[column] == kNone; };
    if (std::all_of(table.begin() + 1, table.end(), is_empty)) continue;
    for (std::size_t i = 0; i < table.size(); ++i) kept[i].push_back(table[i][column]);
  }
  return kept;
}

}  // namespace

std::string verdict(const Json& summary) {
  const Json& results = summary["results"];
  const std::size_t n_seeds = summary["done_by_seed"].size(), n_started = seeds_started(summary);
  const auto own = std::find_if(results.begin(), results.end(),
                                [&](const Json& result) { return result["name"] == summary["ours"]; });
  const Effects effects = effects_of(summary, static_cast<std::size_t>(own - results.begin()));
  const bool has_times = have_equal_lengths(summary);
  if (has_times ? effects.saved.is_null() : (*own)["seconds"].is_null() || results[0]["seconds"].is_null()) {
    return "No result yet: not every configuration has been trained.";
  }
  const std::string text =
      (has_times ? time_text(effects.saved, summary["ours"], summary["baseline"]) : lengths_text(*own, results[0])) +
      "; " + psnr_text(effects.psnr, summary, has_times ? n_started : n_seeds) + ".";
  if (has_times) {
    if (summary["done"] == summary["iterations"] && n_started == n_seeds) return text;
    return "Not finished: " + summary["done"].dump() + " of " + summary["iterations"].dump() + " iterations" +
           in_seeds(n_started, n_seeds) + ". So far: " + text;
  }
  const auto is_complete = [&](const Json& result) { return result["complete_seeds"] == n_seeds; };
  return (std::all_of(results.begin(), results.end(), is_complete) ? "" : "Not finished. So far: ") + text;
}

TextTable results_table(const Json& summary) {
  const bool has_times = have_equal_lengths(summary);
  const std::size_t n_seeds = summary["done_by_seed"].size();
  TextTable table{{has_times ? "configuration" : "at the end of", "seeds", "iterations", "training s", "time saved",
                   kInterval, kOneSeedLimit, "time", "PSNR dB", "difference", kInterval, kOneSeedLimit, "PSNR", "SSIM",
                   "Gaussians"}};
  for (std::size_t i = 0; i < summary["results"].size(); ++i) {
    const Json &own = summary["results"][i], &compared = summary["compared"][i == 0 ? 0 : i - 1];
    // Trainings of one length need not be complete, so each column covers the iterations and seeds that all have done.
    const auto value = [&](const char* measure, const char* of_result) {
      if (!has_times) return mean_of(own[of_result]);
      const Json quality = quality_of(compared, measure);
      return quality.is_null() ? std::nullopt : mean_of(quality[i == 0 ? "baseline" : "ours"]);
    };
    const std::optional<double> seconds =
        has_times ? mean_seconds(compared, i == 0 ? "baseline_s" : "ours_s") : mean_of(own["seconds"]);
    const std::optional<double> count = value(kCountMeasure, "gaussians");
    const std::size_t n = own["complete_seeds"];
    const Effects effects = effects_of(summary, i);
    Cells& row = table.emplace_back();
    row = {own["name"], has_times || n == n_seeds ? kNone : detail::concat(n, " of ", n_seeds),
           format_count(own["iterations"]), cell("%.2f", seconds)};
    add_effect(row, effects.saved, kShareOfTime);
    row.push_back(cell("%.2f", value(kPsnrMeasure, "psnr")));
    add_effect(row, effects.psnr, kDecibels);
    row.push_back(cell("%.4f", value(kSsimMeasure, "ssim")));
    row.push_back(count ? format_count(std::llround(*count)) : kNone);
  }
  return without_empty_columns(table);
}

TextTable balancing_table(const Json& summary) {
  if (summary["balancing"].empty()) return {};
  TextTable table{{"load balancing alone", "time saved", kInterval, kOneSeedLimit, "finding"}};
  for (const Json& gain : summary["balancing"]) {
    table.push_back({gain["name"].get<std::string>() + " against " + gain["unbalanced"].get<std::string>()});
    add_effect(table.back(), gain["saved_by_balancing"], kShareOfTime);
  }
  return without_empty_columns(table);
}

TextTable paper_table(const Json& summary) {
  if (summary["beside_paper"].empty()) return {};
  TextTable table{
      {"time saved", "up to the inflection", "from it", "overall", kInterval, kOneSeedLimit, "finding", "inflection"}};
  for (const Json& pair : summary["beside_paper"]) {
    const auto share = [&](const char* key) {
      const Json& saved = pair[key];
      return saved.is_null() ? kNone : mean_text(saved, kShareOfTime) + in_seeds(saved["n"], seeds_started(summary));
    };
    std::string before = pair["by_seed"].empty() ? kNone : "no switch", after = before, at = kNone;
    if (const Json& inflection = pair["inflection"]; !inflection.is_null()) {
      const auto first = inflection["min"].get<std::int64_t>(), last = inflection["max"].get<std::int64_t>();
      before = share("saved_before_inflection");
      after = share("saved_after_inflection");
      at = format_count(first) + (last > first ? " to " + format_count(last) : "");
    }
    Cells& row = table.emplace_back();
    row = {pair["name"].get<std::string>() + " against " + pair["baseline"].get<std::string>(), before, after};
    add_effect(row, pair["saved_overall"], kShareOfTime);
    row.push_back(at);
  }
  table.push_back({"in the paper", "19.6 %", "7.9 %", "8.5 %", kNone, kNone, kNone, "about 2,000"});
  return without_empty_columns(table);
}

std::string aligned_text(const TextTable& table) {
  std::vector<std::string> lines(table.size());
  for (std::size_t column = 0; !table.empty() && column < table.front().size(); ++column) {
    std::size_t width = 0;
    for (const Cells& row : table) width = std::max(width, row[column].size());
    for (std::size_t i = 0; i < table.size(); ++i) {
      const std::string &text = table[i][column], padding(width - text.size(), ' ');
      lines[i] += column == 0 ? text + padding : "  " + padding + text;
    }
  }
  std::string text;
  for (const std::string& line : lines) text += line + "\n";
  return text;
}

}  // namespace b3dgs
