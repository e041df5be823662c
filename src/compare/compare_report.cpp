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

/// The baseline is grey, the others have colours.
int color_of(std::size_t configuration) {
  return configuration == 0 ? 9 : static_cast<int>((configuration - 1) % 8);
}

/// The runs of the first seed, which the curves show.
std::vector<LabeledRun> first_runs(const Comparison& comparison) {
  std::vector<LabeledRun> runs;
  for (std::size_t i = 0; i < comparison.runs.size(); ++i) {
    const ComparedRun& run = comparison.runs[i].front();
    runs.push_back({comparison.configurations[i].name, run.history, run.record, color_of(i)});
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

/// A section of one run, under its name: of the configuration's first seed that has what it shows. Empty if none has.
std::string of_configuration(const Comparison& comparison, std::size_t index, bool (*has)(const TrainHistory&),
                             std::string (*section)(const TrainHistory&)) {
  for (const ComparedRun& run : comparison.runs[index]) {
    if (!has(run.history)) continue;
    return html::subsection(detail::concat(comparison.configurations[index].name, ", seed ", run.seed),
                            section(run.history));
  }
  return "";
}

/// The section of ours, or else of the first configuration that has what it shows.
std::string of_one(const Comparison& comparison, bool (*has)(const TrainHistory&),
                   std::string (*section)(const TrainHistory&)) {
  std::string first;
  for (std::size_t i = 0; i < comparison.configurations.size(); ++i) {
    const std::string body = of_configuration(comparison, i, has, section);
    if (comparison.configurations[i].name == comparison.summary.ours && !body.empty()) return body;
    if (first.empty()) first = body;
  }
  return first.empty() ? section(TrainHistory{}) : first;  // which says that nothing is there
}

/// All that decided; where no kernel was chosen, the candidates' times of one.
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

std::string what_was_measured(const Comparison& comparison) {
  const ComparisonPlan& plan = comparison.plan;
  const int n_seeds = static_cast<int>(plan.seeds.size()), n_begun = comparison.summary.seeds_begun();
  const std::string scene = scene_name(plan.base.source_path);
  return html::paragraph(detail::concat(
             "Scene ", scene, ", ", format_count(comparison.summary.done), " iterations of each configuration, ",
             n_begun < n_seeds ? detail::concat(n_begun, " of ") : "", n_seeds, n_seeds == 1 ? " seed" : " seeds",
             ", the same views in the same order. The configurations took turns of ", plan.chunk,
             " iterations in a rotating order, so that drift of the machine hits all alike.")) +
         html::paragraph(
             detail::concat("Times are end to end: rendering and its gradients, loss, optimizer, "
                            "densification, uploads and kernel checks. Not in them are reading the scene (",
                            format_seconds(plan.reading_s, 0), ", once for all) and evaluation, saving and ",
                            "checkpoints (", format_seconds(comparison.output_s(), 0), " in all)."),
             "soft") +
         (plan.loading_ms > 0 ? html::paragraph(sentence(describe_loading(comparison)), "soft") : "") +
         html::paragraph(comparison.summary.repetition.empty()
                             ? "How much the machine makes one and the same training differ was not measured (--noise)."
                             : sentence(describe_repetition(comparison.summary)) +
                                   " The figures after ± say so of the same iterations, the largest of all seeds.",
                         "soft");
}

/// "18.3 %", with several seeds "18.3 % (17.9 to 18.8)", with the machine's spread "18.3 % ± 0.4 %"; of fewer than
/// `n_seeds`, that is said.
std::string share_cell(const std::optional<Spread>& share, const std::optional<double>& noise, int n_seeds) {
  if (!share) return "-";
  const std::string range =
      share->n > 1 ? print_to_string(" (%.1f to %.1f)", 100 * share->min, 100 * share->max) : std::string();
  return format_percent(share->mean) + (noise ? " ± " + format_percent(*noise) : "") + range +
         in_seeds(share->n, n_seeds);
}

std::string inflection_cell(const std::optional<Spread>& inflection, int n_seeds) {
  if (!inflection) return "none";
  std::string text = format_count(std::llround(inflection->min));
  if (inflection->range() > 0) text += " to " + format_count(std::llround(inflection->max));
  return text + in_seeds(inflection->n, n_seeds);
}

/// Name, before and after its inflection, overall, inflection.
html::Row saved_row(const std::string& name, const ComparedConfiguration& compared) {
  const int n_seeds = static_cast<int>(compared.by_seed.size());
  return {name, share_cell(compared.before, compared.noise.before, n_seeds),
          share_cell(compared.after, compared.noise.after, n_seeds),
          share_cell(compared.overall, compared.noise.overall, n_seeds), inflection_cell(compared.switch_iteration, n_seeds)};
}

/// What balancing brings by itself.
std::string balancing_part(const Comparison& comparison) {
  const ComparisonSummary& summary = comparison.summary;
  if (summary.balancing.empty()) {
    if (summary.missing_kernels.empty()) return "";
    std::string names;
    for (const std::string& name : summary.missing_kernels) names += (names.empty() ? "" : ", ") + name;
    return html::paragraph(
        "What balancing brings by itself cannot be told here: these kernels, which are not balanced "
        "either, were not trained with the options of " +
        summary.ours + ": " + names + ".");
  }
  std::vector<html::Row> rows;
  int marked = -1;
  for (const BalancingGain& steps : summary.balancing) {
    if (steps.name == summary.ours) marked = static_cast<int>(rows.size());
    const auto cell = [&](const Spread& saved) { return share_cell(saved, summary.noise(), saved.n); };
    rows.push_back({steps.name, steps.naive, cell(steps.to_unbalanced), steps.unbalanced, cell(steps.balancing),
                    cell(steps.whole)});
  }
  return html::table({"balanced", "from", "saved up to the best unbalanced", "which is", "saved from there: balancing",
                      "saved in all"},
                     rows, html::Columns::kFigures, marked) +
         html::paragraph(
             "Each row is of configurations that differ in nothing but forward kernels. What balancing brings is the "
             "share of the best unbalanced kernel's time; the two others are shares of naive's.",
             "soft");
}

/// Every configuration as a whole against the baseline.
std::string configurations_part(const ComparisonSummary& summary) {
  std::vector<html::Row> rows;
  int marked = -1;
  for (const ComparedConfiguration& compared : summary.compared) {
    if (compared.name == summary.ours) marked = static_cast<int>(rows.size());
    rows.push_back(saved_row(compared.name, compared));
    std::string options = compared.has_own_kernel ? "forward kernel" : "";
    for (const std::string& name : compared.differs_in) options += (options.empty() ? "" : ", ") + name;
    rows.back().push_back(options.empty() ? "nothing" : options);
  }
  const ComparedConfiguration* ours = summary.find(summary.ours);
  std::string note =
      "Before and after are of the seeds that have both. The inflection point is the first check after which another "
      "forward kernel was in use.";
  if (ours != nullptr && !ours->switch_iteration) {
    note = ours->name + " has no inflection point here, so that there is no before and after it. " + note;
  }
  return html::table({"share of " + summary.baseline + "'s time saved by", "before inflection", "after it", "overall",
                      "inflection, iteration", "differs in"},
                     rows, html::Columns::kFigures, marked) +
         html::paragraph(note, "soft");
}

/// The paper's figures beside what is measured as they are.
std::string paper_part(const ComparisonSummary& summary) {
  const std::string measured =
      "The paper compares naive with the choice between combined and shared-memory, both with the original's backward "
      "pass and optimizer, on an A100 with its own scene, 960 x 540 px: 19.6 % saved before the inflection at about "
      "iteration 2,000, 7.9 % after it, 8.5 % overall.";
  if (summary.paper_comparisons.empty()) {
    return html::paragraph(measured +
                               " Nothing here compares with that; --configs original,paper:original+kernel=paper "
                               "comes nearest.",
                           "soft");
  }
  std::vector<html::Row> rows;
  for (const PaperComparison& own : summary.paper_comparisons) {
    rows.push_back(saved_row(own.compared.name + " against " + own.baseline, own.compared));
  }
  rows.push_back({"the paper", "19.6 %", "7.9 %", "8.5 %", "about 2,000"});
  return html::table({"as the paper compares", "before inflection", "after it", "overall", "inflection, iteration"},
                     rows) +
         html::paragraph(measured +
                             " Loss, optimizer and projection are this program's own on both sides here, and faster "
                             "than the original's, so the forward pass is a larger share of a step.",
                         "soft");
}

std::string saved_section(const Comparison& comparison) {
  return balancing_part(comparison) + configurations_part(comparison.summary) + paper_part(comparison.summary);
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

std::string time_section(const Comparison& comparison) {
  const std::vector<LabeledRun> runs = first_runs(comparison);
  LineChart total{"Training time over the iterations", "iteration", "seconds of training"};
  LineChart difference{"Seconds saved over the iterations", "iteration",
                       "seconds saved against " + comparison.summary.baseline};
  for (const LabeledRun& run : runs) total.series.push_back(elapsed_curve(run));
  for (std::size_t i = 1; i < runs.size(); ++i) difference.series.push_back(difference_curve(runs[0], runs[i]));
  const bool has_several_seeds = comparison.plan.seeds.size() > 1;
  if (const std::optional<int> inflection = first_kernel_switch(history_of_ours(comparison))) {
    const std::string of_seed = has_several_seeds ? detail::concat(" of seed ", comparison.plan.seeds[0]) : "";
    total.events = difference.events = {
        {static_cast<double>(*inflection), "inflection" + of_seed + ", " + format_count(*inflection)}};
  }
  difference.height = 220;
  const std::string seed = has_several_seeds ? detail::concat(" Curves of seed ", comparison.plan.seeds[0], ".") : "";
  return html::figure(draw(total), "End-to-end training time. The paper's figure 8." + seed) +
         html::figure(draw(difference), "Its difference to " + comparison.summary.baseline +
                                            ": a rising curve saves time at that point of the training." + seed);
}

std::string quality_cell(const Spread& spread, const std::string& measure) {
  const char* format = measure == "SSIM" ? "%.4f" : "%.2f";
  const auto number = [&](double value) {
    return measure == "Gaussians" ? format_count(std::llround(value)) : print_to_string(format, value);
  };
  if (spread.n == 1) return number(spread.mean);
  return number(spread.mean) + " (" + number(spread.min) + " to " + number(spread.max) + ")";
}

std::string quality_section(const Comparison& comparison) {
  const ComparisonSummary& summary = comparison.summary;
  std::string body;
  for (const ComparedConfiguration& compared : summary.compared) {
    std::vector<html::Row> rows;
    for (const QualityDifference& own : compared.quality) {
      rows.push_back({own.measure + in_seeds(own.baseline.n, summary.seeds_begun()), format_count(own.iteration),
                      quality_cell(own.baseline, own.measure), quality_cell(own.ours, own.measure),
                      format_quality_difference(own.measure, own.difference()) +
                          (own.noise ? " ± " + format_quality_difference(own.measure, *own.noise, true) : ""),
                      own.is_equal()          ? "equal"
                      : own.is_within_noise() ? "within the machine's spread"
                                              : "differs"});
    }
    if (!rows.empty()) {
      body += html::table({"quality", "at iteration", summary.baseline, compared.name, "difference", ""}, rows);
    }
  }
  if (body.empty()) return html::paragraph("Quality was not measured yet.", "soft");
  body += html::paragraph(quality_criterion(summary), "soft");
  const std::vector<ChartSeries> psnr = curves(first_runs(comparison), &LogPoint::test_psnr);
  if (psnr.empty()) return body + html::paragraph("No views were held out (--eval): there is no PSNR.", "soft");
  if (psnr[0].points.size() < 3) return body;
  LineChart chart{"PSNR over the iterations", "iteration", "PSNR, dB"};
  chart.from_zero = false;
  chart.series = psnr;
  chart.height = 220;
  return body + html::figure(draw(chart), "PSNR, mean over the test views.");
}

/// "kernel combined, tile 16x8": what sets a configuration apart.
std::string own_options(const TrainConfig& base, const TrainConfig& own) {
  const nlohmann::ordered_json before = config_to_json(base), after = config_to_json(own);
  std::string text = "kernel " + own.kernel;
  for (const auto& [name, value] : after.items()) {
    if (name == "kernel" || value == before.at(name)) continue;
    text += ", " + name + " " + (value.is_string() ? value.get<std::string>() : value.dump());
  }
  return text;
}

std::string settings_section(const Comparison& comparison) {
  nlohmann::ordered_json machine = nlohmann::ordered_json::object();
  std::vector<html::Row> rows;
  for (std::size_t i = 0; i < comparison.configurations.size(); ++i) {
    const ComparedRun& run = comparison.runs[i].front();
    if (!run.record.machine.empty()) machine = run.record.machine;
    rows.push_back({"configuration " + comparison.configurations[i].name,
                    own_options(comparison.plan.base, comparison.configurations[i].config)});
  }
  std::string seeds;
  for (const std::int64_t seed : comparison.plan.seeds) seeds += (seeds.empty() ? "" : ", ") + std::to_string(seed);
  rows.push_back({"seeds", seeds});
  return machine_section(machine, rows);
}

}  // namespace

std::string comparison_report(const Comparison& comparison) {
  const std::vector<LabeledRun> runs = first_runs(comparison);
  const auto has_loads = [](const TrainHistory& history) { return !history.loads.empty(); };
  const std::string body =
      what_was_measured(comparison) + html::section("Time saved", saved_section(comparison)) +
      html::section("Training time", time_section(comparison)) + html::section("Kernels", kernels(comparison)) +
      // The same scene is as uneven for all of them, whatever kernel has to bear it.
      html::section("Load", of_one(comparison, has_loads, load_section)) +
      html::section("Time by stage", stage_section(runs)) + html::section("Quality", quality_section(comparison)) +
      html::section("Renders", preview_section(runs)) +
      html::section("Machine and settings", settings_section(comparison));
  return html::page("Comparison on " + scene_name(comparison.plan.base.source_path), verdict(comparison.summary), body);
}

}  // namespace b3dgs
