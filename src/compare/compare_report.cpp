#include "compare/compare_report.h"

#include <algorithm>
#include <cctype>
#include <cmath>

#include "compare/compare_verdict.h"
#include "core/check.h"
#include "core/print.h"
#include "core/text.h"
#include "report/html_report.h"
#include "report/report_sections.h"

namespace b3dgs {
namespace {

/// A grey for the baseline, colours for the others.
int color_of(std::size_t configuration) {
  return configuration == 0 ? 9 : static_cast<int>((configuration - 1) % 8);
}

/// The runs of the first seed, which the charts show.
std::vector<LabeledRun> first_runs(const Comparison& comparison) {
  std::vector<LabeledRun> runs;
  for (std::size_t i = 0; i < comparison.runs.size(); ++i) {
    const ComparedRun& run = comparison.runs[i].front();
    runs.push_back({comparison.configurations[i].name, run.history, run.info, color_of(i)});
  }
  return runs;
}

/// The configuration that the verdict is about.
const TrainHistory& history_of_ours(const Comparison& comparison) {
  for (std::size_t i = 1; i < comparison.configurations.size(); ++i) {
    if (comparison.configurations[i].name == comparison.summary.ours) return comparison.runs[i].front().history;
  }
  return comparison.runs.back().front().history;
}

/// `section` of the configuration's first seed for which `has` is true, under a heading; empty if there is none.
std::string of_configuration(const Comparison& comparison, std::size_t index, bool (*has)(const TrainHistory&),
                             std::string (*section)(const TrainHistory&)) {
  for (const ComparedRun& run : comparison.runs[index]) {
    if (!has(run.history)) continue;
    return html::subsection(detail::concat(comparison.configurations[index].name, ", seed ", run.seed),
                            section(run.history));
  }
  return "";
}

/// `section` of the configuration that the verdict is about, else of the first configuration for which `has` is true.
std::string of_one(const Comparison& comparison, bool (*has)(const TrainHistory&),
                   std::string (*section)(const TrainHistory&)) {
  std::string first;
  for (std::size_t i = 0; i < comparison.configurations.size(); ++i) {
    std::string body = of_configuration(comparison, i, has, section);
    if (comparison.configurations[i].name == comparison.summary.ours && !body.empty()) return body;
    if (first.empty()) first = body;
  }
  return first.empty() ? section(TrainHistory{}) : first;  // says that there is no data
}

/// The kernels of all configurations with timing checks; without any, the kernels' times of one configuration.
std::string kernels(const Comparison& comparison) {
  const auto has_checks = [](const TrainHistory& history) { return !history.checks.empty(); };
  const auto has_times = [](const TrainHistory& history) { return !history.candidate_times.empty(); };
  std::string body;
  for (std::size_t i = 0; i < comparison.configurations.size(); ++i) {
    body += of_configuration(comparison, i, has_checks, kernel_section);
  }
  return body.empty() ? of_one(comparison, has_times, kernel_section) : body;
}

/// With a capital letter and a full stop.
std::string sentence(std::string text) {
  text[0] = static_cast<char>(std::toupper(static_cast<unsigned char>(text[0])));
  return text + ".";
}

std::string what_was_compared(const Comparison& comparison) {
  const ComparisonPlan& plan = comparison.plan;
  const int n_seeds = static_cast<int>(plan.seeds.size()), n_started = comparison.summary.seeds_started();
  const bool have_one_length = have_equal_lengths(comparison.summary.results);
  return html::paragraph(detail::concat(
      "Scene ", scene_name(plan.base.source_path), ", ",
      have_one_length ? format_count(comparison.summary.done) + " iterations of each configuration, "
                      : std::string("each configuration for its own number of iterations, "),
      n_started < n_seeds ? detail::concat(n_started, " of ") : "", n_seeds, n_seeds == 1 ? " seed" : " seeds",
      ". All configurations trained on the same views in the same order, in turns of ", plan.chunk,
      " iterations, so that changes in the speed of the machine affect all of them alike."));
}

/// "18.3 %", with several seeds "18.3 % (17.9 to 18.8)", with the run-to-run variation "18.3 % ± 0.4 %"; says so if it
/// is of fewer than `n_seeds`.
std::string share_cell(const std::optional<Spread>& share, const std::optional<double>& noise, int n_seeds) {
  if (!share) return "-";
  const std::string range =
      share->n > 1 ? print_to_string(" (%.1f to %.1f)", 100 * share->min, 100 * share->max) : std::string();
  return format_percent(share->mean) + (noise ? " ± " + format_percent(*noise) : "") + range +
         in_seeds(share->n, n_seeds);
}

/// The same with the 95 % interval instead of the range: "18.3 % ± 0.4 % (95 %: 17.0 to 19.6 %)". Without `word` it
/// says
/// ", unclear" or ", equal" of what is no difference.
std::string effect_cell(const std::optional<Effect>& share, const std::optional<double>& noise, int n_seeds,
                        bool has_word) {
  if (!share) return "-";
  const std::string interval = share->margin ? " (95 %: " + interval_text(*share) + ")" : "";
  return format_percent(share->mean) + (noise ? " ± " + format_percent(*noise) : "") + interval +
         (has_word || share->differs() ? "" : ", " + finding_word(*share)) + in_seeds(share->n, n_seeds);
}

std::string switch_cell(const std::optional<Spread>& iteration, int n_seeds) {
  if (!iteration) return "none";
  std::string text = format_count(std::llround(iteration->min));
  if (iteration->range() > 0) text += " to " + format_count(std::llround(iteration->max));
  return text + in_seeds(iteration->n, n_seeds);
}

/// "40.1 s", with several seeds "40.1 s (39.8 to 40.4)".
std::string seconds_cell(const ComparedConfiguration& compared, double TimeSaved::*seconds) {
  std::vector<double> values;
  for (const TimeSaved& saved : compared.by_seed) values.push_back(saved.*seconds);
  const std::optional<Spread> spread = spread_of(values);
  if (!spread) return "-";
  const std::string text = format_seconds(spread->mean, spread->min);
  return spread->n == 1 ? text : text + print_to_string(" (%.1f to %.1f)", spread->min, spread->max);
}

/// Time saved in total, what that says, time saved before and after the switch, and the iteration of the switch.
html::Row saved_cells(const ComparedConfiguration& compared) {
  const int n_seeds = static_cast<int>(compared.by_seed.size());
  return {effect_cell(compared.overall, compared.noise.overall, n_seeds, true),
          compared.overall ? time_word(*compared.overall) : "-",
          share_cell(compared.before, compared.noise.before, n_seeds),
          share_cell(compared.after, compared.noise.after, n_seeds), switch_cell(compared.switch_iteration, n_seeds)};
}
html::Row saved_head() {
  return {"time saved: total", "", "before the switch", "after the switch", "switch at iteration"};
}

html::Row joined(html::Row row, const html::Row& more) {
  row.insert(row.end(), more.begin(), more.end());
  return row;
}

/// The time that load balancing alone saves.
std::string balancing_table(const ComparisonSummary& summary) {
  if (summary.balancing.empty()) {
    if (summary.missing_kernels.empty()) return "";
    std::string names;
    for (const std::string& name : summary.missing_kernels) names += (names.empty() ? "" : ", ") + name;
    return html::paragraph(
        "How much load balancing alone saves is unknown: these kernels without load balancing were not trained with "
        "the options of " +
        summary.ours + ": " + names + ".");
  }
  std::vector<html::Row> rows;
  int marked = -1;
  for (const BalancingGain& gain : summary.balancing) {
    if (gain.name == summary.ours) marked = static_cast<int>(rows.size());
    const auto cell = [&](const Effect& saved) { return effect_cell(saved, summary.noise(), saved.n, false); };
    rows.push_back(
        {gain.name, gain.naive, cell(gain.to_unbalanced), gain.unbalanced, cell(gain.balancing), cell(gain.whole)});
  }
  return html::table({"configuration", "compared with", "saved without load balancing", "by", "saved by load balancing",
                      "saved in total"},
                     rows, html::Columns::kFigures, marked) +
         html::paragraph(
             "The configurations of a row differ only in the forward kernel. Load balancing is compared with the "
             "fastest "
             "kernel without it, as a share of that kernel's time; the other two columns are shares of naive's time.",
             "soft");
}

/// "lambda_dssim 0.2 → 0.4", of few options; of more, how many they are.
std::string differences_cell(const TrainConfig& baseline, const ComparedConfiguration& compared,
                             const TrainConfig& own) {
  constexpr std::size_t kMostNamed = 3;
  const std::vector<std::string>& names = compared.differs_in;
  std::string text = compared.has_own_kernel ? "forward kernel" : "";
  if (names.size() > kMostNamed) {
    return text + (text.empty() ? "" : ", ") + std::to_string(names.size()) + " options (see below)";
  }
  const nlohmann::ordered_json before = config_to_json(baseline), after = config_to_json(own);
  for (const std::string& name : names) {
    text +=
        (text.empty() ? "" : ", ") + name + " " + option_text(before.at(name)) + " → " + option_text(after.at(name));
  }
  return text.empty() ? "nothing" : text;
}

/// Training time of every configuration and the share that it saved of the baseline's.
std::string time_table(const Comparison& comparison) {
  const ComparisonSummary& summary = comparison.summary;
  const bool has_switch =
      std::any_of(summary.compared.begin(), summary.compared.end(),
                  [](const ComparedConfiguration& compared) { return compared.switch_iteration.has_value(); });
  const auto shown = [&](html::Row cells) {
    if (!has_switch) cells.resize(2);
    return cells;
  };
  html::Row first{summary.baseline + " (baseline)", seconds_cell(summary.compared.front(), &TimeSaved::baseline_s)};
  std::vector<html::Row> rows{joined(joined(first, shown(html::Row(saved_head().size(), "-"))), {"-"})};
  int marked = -1;
  for (std::size_t i = 0; i < summary.compared.size(); ++i) {
    const ComparedConfiguration& compared = summary.compared[i];
    if (compared.name == summary.ours) marked = static_cast<int>(rows.size());
    rows.push_back(joined(
        joined({compared.name, seconds_cell(compared, &TimeSaved::ours_s)}, shown(saved_cells(compared))),
        {differences_cell(comparison.configurations[0].config, compared, comparison.configurations[i + 1].config)}));
  }
  std::string note = "Time saved is a share of " + summary.baseline + "'s training time. " + time_criterion(summary);
  if (has_switch) {
    note +=
        " The switch is the first timing check after which another forward kernel was used; before and after it are "
        "means over the seeds that have both.";
  }
  return html::table(joined(joined({"configuration", "training time"}, shown(saved_head())), {"differs in"}), rows,
                     html::Columns::kFigures, marked) +
         html::paragraph(note, "soft");
}

/// Published results beside those of configurations that repeat the published comparison.
std::string paper_section(const ComparisonSummary& summary) {
  const std::string published =
      "The Balanced3DGS paper (arXiv 2412.17378) compares the kernel naive with a choice between the kernels combined "
      "(load-balanced) and shared-memory, both with the backward pass and optimizer of the original 3DGS trainer, on "
      "an "
      "A100 with its own scene at 960 x 540 px. It reports 8.5 % of training time saved in total: 19.6 % before the "
      "switch from combined to shared-memory at about iteration 2,000, and 7.9 % after it.";
  if (summary.paper_comparisons.empty()) {
    return html::paragraph(published +
                               " No configurations here repeat that comparison; --configs "
                               "original,paper:original+kernel=paper comes closest.",
                           "soft");
  }
  std::vector<html::Row> rows;
  for (const PaperComparison& own : summary.paper_comparisons) {
    rows.push_back(joined({own.compared.name + " against " + own.baseline}, saved_cells(own.compared)));
  }
  rows.push_back({"published", "8.5 %", "", "19.6 %", "7.9 %", "about 2,000"});
  return html::table(joined({"comparison"}, saved_head()), rows) +
         html::paragraph(published +
                             " Here, both sides use this program's loss, optimizer and projection, which are faster "
                             "than the original ones, so the forward pass is a larger share of a step.",
                         "soft");
}

ChartSeries elapsed_curve(const LabeledRun& run) {
  ChartSeries series{run.name, {{0, 0}}, run.color};
  for (const LogPoint& point : run.history.points) {
    series.points.push_back({static_cast<double>(point.iteration), point.elapsed_s});
  }
  return series;
}

ChartSeries difference_curve(const LabeledRun& baseline, const LabeledRun& run) {
  ChartSeries series{run.name, {{0, 0}}, run.color};
  const int until = std::min(baseline.history.last_iteration(), run.history.last_iteration());
  for (const LogPoint& point : run.history.points) {
    if (point.iteration > until) break;
    series.points.push_back(
        {static_cast<double>(point.iteration), elapsed_at(baseline.history, point.iteration) - point.elapsed_s});
  }
  return series;
}

std::string time_charts(const Comparison& comparison) {
  const std::vector<LabeledRun> runs = first_runs(comparison);
  const std::string& baseline = comparison.summary.baseline;
  LineChart total{"Training time over the iterations", "iteration", "training time, s"};
  LineChart difference{"Time saved over the iterations", "iteration", "s saved compared with " + baseline};
  for (const LabeledRun& run : runs) total.series.push_back(elapsed_curve(run));
  for (std::size_t i = 1; i < runs.size(); ++i) difference.series.push_back(difference_curve(runs[0], runs[i]));
  const bool has_several_seeds = comparison.plan.seeds.size() > 1;
  const auto first_seed = detail::concat("seed ", comparison.plan.seeds[0]);
  if (const std::optional<int> iteration = first_kernel_switch(history_of_ours(comparison))) {
    total.events =
        difference.events = {{static_cast<double>(*iteration), "kernel switch at " + format_count(*iteration) +
                                                                   (has_several_seeds ? " (" + first_seed + ")" : "")}};
  }
  difference.height = 220;
  const std::string note = has_several_seeds ? " Shown for " + first_seed + "." : "";
  return html::figure(draw(total), "Training time of each configuration." + note) +
         html::figure(draw(difference), "Time saved compared with " + baseline +
                                            ": while a curve rises, its configuration is faster." + note);
}

std::string time_section(const Comparison& comparison) {
  const ComparisonPlan& plan = comparison.plan;
  const ComparisonSummary& summary = comparison.summary;
  return time_table(comparison) + balancing_table(summary) +
         html::paragraph(summary.repetition.empty()
                             ? "The run-to-run variation of times was not measured (--noise does that)."
                             : sentence(describe_repetition(summary)) +
                                   " Values after ± are the run-to-run variation over the same iterations, the largest "
                                   "of all seeds.",
                         "soft") +
         time_charts(comparison) +
         html::paragraph(detail::concat("Times include rendering, gradients, loss, optimizer, density control, uploads "
                                        "and timing checks of kernels. Reading the scene (",
                                        format_seconds(plan.reading_s, 0),
                                        ", once for all configurations) and evaluation, saving and checkpoints (",
                                        format_seconds(comparison.output_s(), 0), " in total) are not included."),
                         "soft") +
         (plan.loading_ms > 0 ? html::paragraph(sentence(describe_loading(comparison)), "soft") : "");
}

std::string quality_cell(const Spread& spread, const std::string& measure) {
  const char* format = measure == "SSIM" ? "%.4f" : "%.2f";
  const auto number = [&](double value) {
    return measure == "Gaussians" ? format_count(std::llround(value)) : print_to_string(format, value);
  };
  if (spread.n == 1) return number(spread.mean);
  return number(spread.mean) + " (" + number(spread.min) + " to " + number(spread.max) + ")";
}

/// "+0.20 ± 0.25 (95 %: -0.28 to +0.68)": with the run-to-run variation and, with several seeds, the interval.
std::string quality_difference_cell(const QualityDifference& own) {
  const auto number = [&](double value) { return format_quality_difference(own.measure, value); };
  return number(own.gained.mean) + (own.noise ? " ± " + format_quality_difference(own.measure, *own.noise, true) : "") +
         (own.gained.margin ? " (95 %: " + number(own.gained.low()) + " to " + number(own.gained.high()) + ")" : "");
}

std::string quality_section(const Comparison& comparison) {
  const ComparisonSummary& summary = comparison.summary;
  std::string body;
  for (const ComparedConfiguration& compared : summary.compared) {
    std::vector<html::Row> rows;
    for (const QualityDifference& own : compared.quality) {
      rows.push_back({own.measure + in_seeds(own.baseline.n, summary.seeds_started()), format_count(own.iteration),
                      quality_cell(own.baseline, own.measure), quality_cell(own.ours, own.measure),
                      quality_difference_cell(own), finding_word(own.gained)});
    }
    if (!rows.empty()) {
      body += html::table({"measure", "at iteration", summary.baseline, compared.name, "difference", ""}, rows);
    }
  }
  if (body.empty()) return html::paragraph("Quality has not been measured yet.", "soft");
  body += html::paragraph(quality_criterion(summary), "soft");
  if (comparison.configurations.front().config.train_test_exp) body += html::paragraph(kMeasuredHalf, "soft");
  const std::vector<ChartSeries> psnr = curves(first_runs(comparison), &LogPoint::test_psnr);
  if (psnr.empty()) {
    return body + html::paragraph("No test views were held out (--no_eval), so there is no PSNR.", "soft");
  }
  if (psnr[0].points.size() < 2) return body;  // the tables have this one value
  return body + curve_figure({"PSNR", "dB", "PSNR, mean over the test views.", false}, psnr);
}

std::string results(const Comparison& comparison) {
  std::vector<int> colors;
  for (std::size_t i = 0; i < comparison.configurations.size(); ++i) colors.push_back(color_of(i));
  return results_section(comparison.summary.results, colors);
}

/// Where configurations train for different numbers of iterations, a note before what compares equal iterations.
std::string common_iterations_note(const Comparison& comparison) {
  if (have_equal_lengths(comparison.summary.results)) return "";
  return html::paragraph("Compared over the first " + format_count(comparison.summary.done) +
                             " iterations, which all configurations have done, and so not at the end of the longer "
                             "ones.",
                         "soft");
}

/// The options that are the same in all configurations, and default values for the others.
TrainConfig common_config(const std::vector<Configuration>& configurations) {
  TrainConfig common;
  nlohmann::ordered_json values = config_to_json(common);
  const nlohmann::ordered_json first = config_to_json(configurations.front().config);
  for (const auto& [name, value] : first.items()) values[name] = value;
  const nlohmann::ordered_json defaults = config_to_json(common);
  for (const Configuration& own : configurations) {
    const nlohmann::ordered_json other = config_to_json(own.config);
    for (const auto& [name, value] : first.items()) {
      if (other.at(name) != value) values[name] = defaults.at(name);
    }
  }
  config_from_json(common, values, /*place=*/"");
  return common;
}

/// The options in which configurations differ, a column for each of these.
std::string options_table(const std::vector<Configuration>& configurations) {
  html::Row head{"option"};
  std::vector<nlohmann::ordered_json> values;
  for (const Configuration& own : configurations) {
    head.push_back(own.name);
    values.push_back(config_to_json(own.config));
  }
  std::vector<html::Row> rows;
  for (const auto& [name, first] : values.front().items()) {
    html::Row row{name};
    bool differs = false;
    for (const nlohmann::ordered_json& own : values) {
      row.push_back(option_text(own.at(name)));
      differs = differs || own.at(name) != first;
    }
    if (differs) rows.push_back(row);
  }
  if (rows.empty()) return html::paragraph("The configurations have the same options.", "soft");
  return html::table(head, rows, html::Columns::kWords);
}

std::string settings(const Comparison& comparison) {
  const ComparisonPlan& plan = comparison.plan;
  nlohmann::ordered_json machine = nlohmann::ordered_json::object();
  std::vector<html::Row> rows{{"source scene", plan.base.source_path}};
  const ModelFolder first = plan.folder(comparison.configurations.front(), plan.seeds.front());
  if (const std::string photographs = photographs_text(first); !photographs.empty()) {
    rows.push_back({"resolution", photographs});
  }
  std::string seeds;
  for (const std::int64_t seed : plan.seeds) seeds += (seeds.empty() ? "" : ", ") + std::to_string(seed);
  rows.push_back({"seeds", seeds});
  const std::string shared = changed_options(TrainConfig{}, common_config(comparison.configurations));
  rows.push_back({"options of all", (shared.empty() ? "" : shared + "; ") +
                                        "otherwise, but for the table below, as in --preset original"});
  for (const std::vector<ComparedRun>& runs : comparison.runs) {
    if (!runs.front().info.machine.empty()) machine = runs.front().info.machine;
  }
  return settings_section(rows, machine) + options_table(comparison.configurations);
}

}  // namespace

std::string comparison_report(const Comparison& comparison) {
  const std::vector<LabeledRun> runs = first_runs(comparison);
  const auto has_loads = [](const TrainHistory& history) { return !history.loads.empty(); };
  const std::string body =
      what_was_compared(comparison) + html::section("Results", results(comparison)) +
      html::section("Photographs and renders", preview_section(runs)) +
      html::section("Quality", common_iterations_note(comparison) + quality_section(comparison)) +
      html::section("Training time", common_iterations_note(comparison) + time_section(comparison)) +
      html::section("Scene, options and machine", settings(comparison)) +
      html::folded_section("Time by stage of the training step", stage_section(runs)) +
      html::folded_section("Kernels: which were used, and why", kernels(comparison)) +
      // The load depends on the scene, hardly on the kernel: one configuration represents all.
      html::folded_section("Load: Gaussians per tile and per pixel", of_one(comparison, has_loads, load_section)) +
      html::folded_section("Published results", paper_section(comparison.summary)) +
      html::folded_section("Words", words_section());
  return html::page("Comparison on " + scene_name(comparison.plan.base.source_path), verdict(comparison.summary), body);
}

}  // namespace b3dgs
