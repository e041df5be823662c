#include "report/report_sections.h"

#include <algorithm>
#include <limits>
#include <map>
#include <utility>

#include "core/check.h"
#include "core/print.h"
#include "raster/stages.h"
#include "report/html_report.h"
#include "scene/images/image_io.h"

namespace b3dgs {
namespace {

std::string readable(std::string name) {
  std::replace(name.begin(), name.end(), '_', ' ');
  return name;
}

std::optional<double> find(const NamedTimes& times, const std::string& name) {
  for (const auto& [known, ms] : times) {
    if (known == name) return ms;
  }
  return std::nullopt;
}

/// Figures of one column have their points below each other.
std::string print_ms(double ms) {
  return print_to_string("%.3f", ms);
}

/// In the order of a step; others follow.
std::vector<std::string> stage_names(const std::vector<NamedTimes>& all) {
  std::vector<std::string> names;
  const auto add = [&](const std::string& name) {
    const auto has = [&](const NamedTimes& times) { return find(times, name).has_value(); };
    const bool is_new = std::find(names.begin(), names.end(), name) == names.end();
    if (is_new && std::any_of(all.begin(), all.end(), has)) names.push_back(name);
  };
  for (const char* name : kStageNames) add(name);
  for (const NamedTimes& times : all) {
    for (const auto& [name, ms] : times) add(name);
  }
  return names;
}

std::string candidate_figure(const TrainHistory& history, const std::string& pass) {
  std::vector<ChartSeries> series;
  std::vector<ChartEvent> events;
  for (const CandidateTimes& timed : history.candidate_times) {
    if (timed.pass != pass) continue;
    for (const auto& [name, ms] : timed.times_ms) {
      auto candidate = std::find_if(series.begin(), series.end(), [&](const auto& s) { return s.name == name; });
      if (candidate == series.end()) {
        series.push_back({name, {}, static_cast<int>(series.size()), true});
        candidate = series.end() - 1;
      }
      candidate->points.push_back({static_cast<double>(timed.iteration), ms});
    }
  }
  for (const KernelCheckEvent& check : history.checks) {
    if (check.pass == pass && check.has_changed()) {
      events.push_back({static_cast<double>(check.iteration), "to " + check.after});
    }
  }
  if (series.empty()) return "";
  const LineChart chart{"Time of the " + pass + " candidates over the training",
                        "iteration",
                        "ms per " + pass + " pass of the kernel",
                        ScaleKind::kLinear,
                        true,
                        {},
                        series,
                        events};
  return html::figure(draw(chart),
                      "Kernel time of the " + pass +
                          " candidates over the training, each timed on the same views. The paper's figure 7.");
}

/// What computed something else is a fault to be looked into: it stands before all times.
std::string refusals(const TrainHistory& history) {
  std::string body;
  for (const KernelCheckEvent& check : history.checks) {
    if (check.refused.empty()) continue;
    std::string names;
    for (const std::string& name : check.refused) names += (names.empty() ? "" : ", ") + name;
    const std::string said = check.refused.front() + " is disabled: ";  // by the reason, before the fault itself
    const bool is_said = check.refused.size() == 1 && check.reason.compare(0, said.size(), said) == 0;
    body +=
        html::paragraph(detail::concat(names, check.refused.size() == 1 ? " was" : " were",
                                       " refused: ", is_said ? check.reason.substr(said.size()) : check.reason,
                                       " (iteration ", format_tick(check.iteration, 1), ", ", check.pass, " pass)."));
  }
  return body;
}

/// "combined 1.200 (0.030), shared-memory 1.100"
std::string times_and_spreads(const KernelCheckEvent& check) {
  std::string text;
  for (const auto& [name, ms] : check.times_ms) {
    text += (text.empty() ? "" : ", ") + name + " " + print_ms(ms);
    if (const std::optional<double> spread = find(check.spread_ms, name)) text += " (" + print_ms(*spread) + ")";
  }
  return text.empty() ? "-" : text;
}

/// Rows for kernels that other options brought when a training was continued after `iteration`. `in_use` has the
/// kernels by pass.
std::vector<html::Row> changes_at(const ResumeEvent& resume, std::map<std::string, std::string>& in_use) {
  std::string reason = "continued";
  for (std::size_t i = 0; i < resume.changed_options.size(); ++i) {
    reason += (i == 0 ? " with " : ", ") + resume.changed_options[i];
  }
  std::vector<html::Row> rows;
  for (const auto& [pass, kernel] :
       {std::pair("forward", resume.kernel), std::pair("backward", resume.backward_kernel)}) {
    const std::string before = std::exchange(in_use[pass], kernel);
    if (before.empty() || kernel.empty() || before == kernel) continue;
    rows.push_back({format_tick(resume.iteration + 1, 1), pass, "-", "-", "from " + before + " to " + kernel, reason});
  }
  return rows;
}

std::string decisions(const TrainHistory& history) {
  std::vector<html::Row> rows;
  double cost_ms = 0, warm_up_ms = 0;
  bool has_cost = false;
  std::map<std::string, std::string> in_use;
  auto resume = history.resumes.begin();
  const auto add_resumes_before = [&](int iteration) {
    for (; resume != history.resumes.end() && resume->iteration < iteration; ++resume) {
      const std::vector<html::Row> changes = changes_at(*resume, in_use);
      rows.insert(rows.end(), changes.begin(), changes.end());
    }
  };
  for (const KernelCheckEvent& check : history.checks) {
    add_resumes_before(check.iteration);
    in_use[check.pass] = check.after;
    has_cost = has_cost || check.cost_ms;
    cost_ms += check.cost_ms.value_or(0);
    warm_up_ms += check.warm_up_ms.value_or(0);
    rows.push_back({format_tick(check.iteration, 1), check.pass, times_and_spreads(check),
                    check.views ? std::to_string(*check.views) : "-",
                    check.has_changed() ? "from " + check.before + " to " + check.after : check.after, check.reason});
  }
  add_resumes_before(std::numeric_limits<int>::max());
  std::string body = html::table({"iteration", "pass", "ms, median over views (spread)", "views", "kernel", "reason"},
                                 rows, html::Columns::kWords);
  const double elapsed_s = history.points.empty() ? 0 : history.points.back().elapsed_s;
  if (has_cost && elapsed_s > 0) {
    const bool is_one = history.checks.size() == 1;
    body += html::paragraph(
        detail::concat(is_one ? "The check took " : "The checks took ", format_figure(cost_ms), " ms, ",
                       format_figure(0.1 * cost_ms / elapsed_s), " % of the training time, which ",
                       is_one ? "it is part of." : "they are part of.",
                       warm_up_ms > 0
                           ? " Loading the candidates' code before their first check, once in a process, took " +
                                 format_figure(warm_up_ms) + " ms more (" +
                                 format_figure(0.1 * warm_up_ms / elapsed_s) + " %), which is training time too."
                           : ""),
        "soft");
  }
  return body;
}

/// Which forward kernel did which iterations: by checks, or by a resume with another --kernel.
std::string kernels_in_use(const TrainHistory& history) {
  const std::vector<KernelPeriod> periods = kernel_periods(history);
  if (periods.empty()) return "";
  if (periods.size() == 1) return html::paragraph("The forward kernel was " + periods[0].kernel + " all the time.");
  std::vector<html::Row> rows;
  for (std::size_t i = 0; i < periods.size(); ++i) {
    const KernelPeriod& period = periods[i];
    const bool is_by_check =
        std::any_of(history.checks.begin(), history.checks.end(), [&](const KernelCheckEvent& check) {
          return check.pass == "forward" && check.iteration == period.from + 1 && check.after == period.kernel;
        });
    rows.push_back({period.kernel, format_tick(period.from + 1, 1) + " to " + format_tick(period.until, 1),
                    is_by_check ? "by a check"
                    : i == 0    ? "from the start"
                                : "by a resume with another --kernel"});
  }
  return html::table({"forward kernel", "iterations", "in use"}, rows, html::Columns::kWords);
}

using LoadField = std::optional<LoadFigures> LoadEvent::*;

std::string load_figure(const TrainHistory& history, LoadField field, const std::string& title,
                        const std::string& y_label, const std::string& caption) {
  std::vector<ChartPoint> min, median, p90, p99, max;
  const LoadFigures *first = nullptr, *last = nullptr;
  for (const LoadEvent& statistics : history.loads) {
    if (!(statistics.*field)) continue;
    const LoadFigures& load = *(statistics.*field);
    const double x = statistics.iteration;
    min.push_back({x, load.min});
    median.push_back({x, load.median});
    p90.push_back({x, load.p90});
    p99.push_back({x, load.p99});
    max.push_back({x, load.max});
    first = first == nullptr ? &load : first;
    last = &load;
  }
  if (first == nullptr) return "";
  LineChart chart{title, "iteration", y_label, ScaleKind::kLog};
  chart.bands = {{"99 % to maximum", p99, max, 0, 0.2},
                 {"90 % to 99 %", p90, p99, 0, 0.4},
                 {"median to 90 %", median, p90, 0, 0.6},
                 {"minimum to median", min, median, 8, 0.3}};
  chart.series = {{"median", median, 0, median.size() <= 40}};
  const std::string gini = detail::concat(" Gini coefficient ", format_figure(first->gini), " at first, ",
                                          format_figure(last->gini), " at last (0: all alike).");
  return html::figure(draw(chart), caption + gini);
}

std::string load_histograms(const TrainHistory& history, LoadField field, const std::string& title,
                            const std::string& x_label, const std::string& caption) {
  std::vector<const LoadEvent*> filled;
  for (const LoadEvent& statistics : history.loads) {
    if (statistics.*field && !(statistics.*field)->log2_bins.empty()) filled.push_back(&statistics);
  }
  if (filled.empty()) return "";
  constexpr std::size_t kMostPanels = 4;
  const std::size_t n = std::min(kMostPanels, filled.size());
  HistogramRow chart{title, x_label, {}};
  for (std::size_t i = 0; i < n; ++i) {
    const LoadEvent& statistics = *filled[n > 1 ? i * (filled.size() - 1) / (n - 1) : 0];
    chart.panels.push_back({"iteration " + format_tick(statistics.iteration, 1), (statistics.*field)->log2_bins});
  }
  return html::figure(draw(chart), caption);
}

}  // namespace

std::vector<ChartSeries> curves(const std::vector<ReportedRun>& runs, std::optional<double> LogPoint::*field) {
  std::vector<ChartSeries> series;
  for (const ReportedRun& run : runs) {
    ChartSeries curve{run.name, {}, run.color};
    for (const LogPoint& point : run.history.points) {
      if (point.*field) curve.points.push_back({static_cast<double>(point.iteration), *(point.*field)});
    }
    curve.has_markers = curve.points.size() <= 20;
    if (!curve.points.empty()) series.push_back(std::move(curve));
  }
  return series;
}

std::vector<ChartSeries> count_curves(const std::vector<ReportedRun>& runs) {
  std::vector<ChartSeries> series;
  for (const ReportedRun& run : runs) {
    ChartSeries curve{run.name, {}, run.color};
    for (const LogPoint& point : run.history.points) {
      if (point.count)
        curve.points.push_back({static_cast<double>(point.iteration), static_cast<double>(*point.count)});
    }
    if (!curve.points.empty()) series.push_back(std::move(curve));
  }
  return series;
}

NamedTimes mean_stages(const TrainHistory& history) {
  NamedTimes sums;
  double n = 0;
  for (const LogPoint& point : history.points) {
    if (point.stages_ms.empty()) continue;
    ++n;
    for (const auto& [name, ms] : point.stages_ms) {
      auto stage = std::find_if(sums.begin(), sums.end(), [&](const auto& sum) { return sum.first == name; });
      if (stage == sums.end()) {
        sums.emplace_back(name, 0);
        stage = sums.end() - 1;
      }
      stage->second += ms;
    }
  }
  for (auto& [name, ms] : sums) ms /= n;
  return sums;
}

std::string stage_section(const std::vector<ReportedRun>& runs) {
  std::vector<NamedTimes> stages;
  for (const ReportedRun& run : runs) stages.push_back(mean_stages(run.history));
  const std::vector<std::string> names = stage_names(stages);
  if (names.empty()) return html::paragraph("Times by stage were not sampled in this training.", "soft");
  StackedBars chart{"Mean time of a step by stage", "ms", {}, {}};
  html::Row head{"stage, ms per step"};
  for (const ReportedRun& run : runs) head.push_back(run.name);
  for (const std::string& name : names) chart.part_names.push_back(readable(name));
  for (std::size_t i = 0; i < runs.size(); ++i) {
    if (stages[i].empty()) continue;
    chart.rows.push_back({runs[i].name, {}});
    for (const std::string& name : names) chart.rows.back().parts.push_back(find(stages[i], name).value_or(0));
  }
  std::vector<html::Row> rows;
  for (const std::string& name : names) {
    rows.push_back({readable(name)});
    for (const NamedTimes& times : stages) {
      const std::optional<double> ms = find(times, name);
      rows.back().push_back(ms ? print_ms(*ms) : "");
    }
  }
  return html::figure(draw(chart), "Mean time of a step over all samples; host is what no stage accounts for.") +
         html::table(head, rows);
}

std::string kernel_section(const TrainHistory& history) {
  if (history.checks.empty() && history.candidate_times.empty()) {
    return kernels_in_use(history) + html::paragraph("No kernels were timed: what is fixed needs no choice.", "soft");
  }
  return refusals(history) + kernels_in_use(history) + candidate_figure(history, "forward") +
         candidate_figure(history, "backward") + (history.checks.empty() ? "" : decisions(history));
}

std::string load_section(const TrainHistory& history) {
  const std::string body =
      load_figure(history, &LoadEvent::tile_lists, "Gaussians per tile over the training", "Gaussians per tile",
                  "How many Gaussians the tiles' lists hold, as bands between quantiles over all tiles.") +
      load_figure(history, &LoadEvent::pixel_processed, "Gaussians per pixel over the training",
                  "Gaussians processed per pixel",
                  "How many Gaussians a pixel goes through until it is done, as bands between quantiles over all "
                  "pixels.") +
      load_histograms(history, &LoadEvent::tile_lists, "Distribution of Gaussians per tile at several iterations",
                      "Gaussians per tile, bins that double",
                      "Share of tiles by length of their list. The paper's figure 5, per block.") +
      load_histograms(history, &LoadEvent::pixel_processed, "Distribution of Gaussians per pixel at several iterations",
                      "Gaussians processed per pixel, bins that double",
                      "Share of pixels by Gaussians processed. The paper's figure 5, per thread.");
  return body.empty() ? html::paragraph("Load statistics were not taken.", "soft") : body;
}

std::string preview_section(const std::vector<ReportedRun>& runs) {
  if (runs.empty() || runs[0].record.previews.empty()) return html::paragraph("No views were rendered.", "soft");
  std::vector<html::Picture> pictures;
  const auto add = [&](const std::filesystem::path& file, const std::string& caption, const std::string& alt) {
    if (!std::filesystem::exists(file)) return;  // lost since: the rest of the report is still worth having
    pictures.push_back({caption, alt, html::data_uri(read_image(file, false))});
  };
  for (std::size_t i = 0; i < runs[0].record.previews.size(); ++i) {
    const Preview& first = runs[0].record.previews[i];
    add(first.truth, "photograph " + first.view, "photograph " + first.view);
    for (const ReportedRun& run : runs) {
      if (i >= run.record.previews.size()) continue;
      const Preview& preview = run.record.previews[i];
      add(preview.render, run.name + ", " + format_figure(preview.psnr) + " dB", run.name + " renders " + preview.view);
    }
  }
  return html::paragraph(runs[0].record.held_out ? "Views held out from training."
                                                 : "No views were held out (--eval): these were trained on.",
                         "soft") +
         html::picture_grid(pictures, runs.size() + 1);
}

std::string machine_section(const nlohmann::ordered_json& machine, const std::vector<html::Row>& more) {
  static const std::map<std::string, std::string> kNames{{"program", "program"},
                                                         {"cpu", "CPU"},
                                                         {"cores", "logical cores"},
                                                         {"memory_gb", "memory, GB"},
                                                         {"device", "trained on"},
                                                         {"gpu", "GPU"},
                                                         {"gpu_memory_gb", "GPU memory, GB"},
                                                         {"driver", "driver"},
                                                         {"cuda", "CUDA"},
                                                         {"libtorch", "LibTorch"}};
  std::vector<html::Row> rows;
  for (const auto& [key, value] : machine.items()) {
    const auto name = kNames.find(key);
    const std::string text = value.is_string()   ? value.get<std::string>()
                             : value.is_number() ? format_figure(value.get<double>())
                                                 : value.dump();
    rows.push_back({name == kNames.end() ? readable(key) : name->second, text});
  }
  rows.insert(rows.end(), more.begin(), more.end());
  return html::table({}, rows, html::Columns::kWords);
}

}  // namespace b3dgs
