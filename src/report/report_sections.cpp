#include "report/report_sections.h"

#include <algorithm>
#include <map>
#include <set>

#include "core/check.h"
#include "core/print.h"
#include "core/text.h"
#include "model/cameras/cameras_json.h"
#include "raster/stages.h"
#include "scene/images/image_io.h"

namespace b3dgs {
namespace {

std::string without_underscores(std::string name) {
  std::replace(name.begin(), name.end(), '_', ' ');
  return name;
}

/// A stage of train.jsonl in words.
std::string stage_text(const std::string& name) {
  static const std::map<std::string, std::string> kTexts{{"upload", "upload of the photograph"},
                                                         {"project", "projection"},
                                                         {"bin", "tile lists"},
                                                         {"blend_forward", "forward blending"},
                                                         {"blend_backward", "backward blending"},
                                                         {"project_backward", "backward projection"},
                                                         {"densify", "density control"},
                                                         {"host", "remaining CPU time"}};
  const auto text = kTexts.find(name);
  return text == kTexts.end() ? without_underscores(name) : text->second;
}

std::optional<double> find(const NamedTimes& times, const std::string& name) {
  for (const auto& [known, ms] : times) {
    if (known == name) return ms;
  }
  return std::nullopt;
}

/// In the order of a step, followed by any others.
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

/// "PSNR: naive 21.5 dB, adaptive 21.6 dB (iteration 60)."
std::string curve_sentence(const Quantity& quantity, const std::vector<ChartSeries>& series) {
  std::string values;
  std::set<double> iterations;
  for (const ChartSeries& curve : series) {
    if (curve.points.empty()) continue;
    values += (values.empty() ? "" : ", ") + (series.size() > 1 ? curve.name + " " : "") +
              format_figure(curve.points.front().y) + (quantity.unit.empty() ? "" : " " + quantity.unit);
    iterations.insert(curve.points.front().x);
  }
  if (values.empty()) return "";
  std::string text = quantity.name + ": " + values;
  if (iterations.size() == 1) text += " (iteration " + format_tick(*iterations.begin(), 1) + ")";
  return html::paragraph(text + ".");
}

}  // namespace

std::string option_text(const nlohmann::ordered_json& value) {
  if (value.is_string()) return value.get<std::string>();
  if (!value.is_array()) return value.dump();
  std::string text;
  for (const auto& entry : value) text += (text.empty() ? "" : " ") + option_text(entry);
  return text.empty() ? "none" : text;
}

std::vector<ChartSeries> curves(const std::vector<LabeledRun>& runs, std::optional<double> LogPoint::*field) {
  std::vector<ChartSeries> series;
  for (const LabeledRun& run : runs) {
    ChartSeries curve{run.name, {}, run.color};
    for (const LogPoint& point : run.history.points) {
      if (point.*field) curve.points.push_back({static_cast<double>(point.iteration), *(point.*field)});
    }
    curve.has_markers = curve.points.size() <= 20;
    if (!curve.points.empty()) series.push_back(std::move(curve));
  }
  return series;
}

std::vector<ChartSeries> count_curves(const std::vector<LabeledRun>& runs) {
  std::vector<ChartSeries> series;
  for (const LabeledRun& run : runs) {
    ChartSeries curve{run.name, {}, run.color};
    for (const LogPoint& point : run.history.points) {
      if (point.count)
        curve.points.push_back({static_cast<double>(point.iteration), static_cast<double>(*point.count)});
    }
    if (!curve.points.empty()) series.push_back(std::move(curve));
  }
  return series;
}

std::string curve_figure(const Quantity& quantity, const std::vector<ChartSeries>& series,
                         const std::vector<ChartEvent>& events, int height) {
  const auto is_curve = [](const ChartSeries& curve) { return curve.points.size() > 1; };
  if (std::none_of(series.begin(), series.end(), is_curve)) return curve_sentence(quantity, series);
  LineChart chart{quantity.name + " over the iterations", "iteration",
                  quantity.name + (quantity.unit.empty() ? "" : ", " + quantity.unit)};
  chart.from_zero = quantity.from_zero;
  chart.series = series;
  chart.events = events;
  chart.height = height;
  return html::figure(draw(chart), quantity.caption);
}

NamedTimes mean_stages(const TrainHistory& history) {
  NamedTimes sums;
  double n = 0;
  for (const LogPoint& point : history.points) {
    if (point.stages_ms.empty()) continue;
    ++n;
    for (const auto& [name, ms] : point.stages_ms) {
      auto stage =
          std::find_if(sums.begin(), sums.end(), [&name = name](const auto& sum) { return sum.first == name; });
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

std::string stage_section(const std::vector<LabeledRun>& runs) {
  std::vector<NamedTimes> stages;
  stages.reserve(runs.size());
  for (const LabeledRun& run : runs) stages.push_back(mean_stages(run.history));
  const std::vector<std::string> names = stage_names(stages);
  if (names.empty()) return html::paragraph("Stages of the training step were not timed.", "soft");
  StackedBars chart{"Mean time of a step by stage", "ms", {}, {}};
  html::Row head{"stage of a step"};
  for (const LabeledRun& run : runs) head.push_back(runs.size() == 1 ? "mean time, ms" : run.name + ", ms");
  for (const std::string& name : names) chart.part_names.push_back(stage_text(name));
  for (std::size_t i = 0; i < runs.size(); ++i) {
    if (stages[i].empty()) continue;
    chart.rows.push_back({runs[i].name, {}});
    for (const std::string& name : names) chart.rows.back().parts.push_back(find(stages[i], name).value_or(0));
  }
  std::vector<html::Row> rows;
  for (const std::string& name : names) {
    rows.push_back({stage_text(name)});
    for (const NamedTimes& times : stages) {
      const std::optional<double> ms = find(times, name);
      rows.back().push_back(ms ? print_to_string("%.3f", *ms) : "");
    }
  }
  return html::figure(draw(chart), "Mean time of a training step by stage, over all steps that were timed by stage.") +
         html::table(head, rows);
}

std::string preview_section(const std::vector<LabeledRun>& runs) {
  if (runs.empty() || runs[0].info.previews.empty()) return html::paragraph("No views have been rendered yet.", "soft");
  std::vector<html::Picture> pictures;
  const auto add = [&](const std::filesystem::path& file, const std::string& caption, const std::string& alt) {
    if (!std::filesystem::exists(file)) return;  // deleted since: the report is written without it
    pictures.push_back({caption, alt, html::data_uri(read_image(file, false))});
  };
  for (std::size_t i = 0; i < runs[0].info.previews.size(); ++i) {
    const Preview& first = runs[0].info.previews[i];
    add(first.photograph, "photograph " + first.view, "photograph " + first.view);
    for (const LabeledRun& run : runs) {
      if (i >= run.info.previews.size()) continue;
      const Preview& preview = run.info.previews[i];
      add(preview.render, (runs.size() > 1 ? run.name : "render") + ", PSNR " + format_figure(preview.psnr) + " dB",
          "render of " + preview.view + " by " + run.name);
    }
  }
  return html::picture_grid(pictures, runs.size() + 1) +
         html::paragraph(runs[0].info.held_out
                             ? "These are test views: they were held out from training."
                             : "These views were trained on; no test views were held out (--eval does that).",
                         "soft");
}

std::string changed_options(const TrainConfig& base, const TrainConfig& own) {
  static const std::set<std::string> kShownElsewhere{"source_path", "model_path", "device"};
  const nlohmann::ordered_json before = config_to_json(base), after = config_to_json(own);
  std::string text;
  for (const auto& [name, value] : after.items()) {
    if (value == before.at(name) || kShownElsewhere.count(name) > 0) continue;
    text += (text.empty() ? "" : ", ") + name + " " + option_text(value);
  }
  return text;
}

std::string photographs_text(const ModelFolder& folder) {
  std::vector<NamedCamera> cameras;
  try {
    cameras = read_cameras_json(folder.cameras());
  } catch (const Error&) {
    return "";
  }
  std::set<std::pair<int, int>> sizes;
  for (const NamedCamera& named : cameras) sizes.emplace(named.camera.width, named.camera.height);
  if (sizes.empty()) return "";
  const auto size_text = [](const std::pair<int, int>& size) {
    return detail::concat(size.first, " x ", size.second, " px");
  };
  std::string text = format_count(static_cast<std::int64_t>(cameras.size())) + " photographs, ";
  if (sizes.size() > 1) text += "from " + size_text(*sizes.begin()) + " to ";
  return text + size_text(*sizes.rbegin());
}

std::string settings_section(std::vector<html::Row> rows, const nlohmann::ordered_json& machine) {
  static const std::map<std::string, std::string> kNames{{"cpu", "CPU"},
                                                         {"cores", "logical cores"},
                                                         {"memory_gb", "host memory, GB"},
                                                         {"device", "trained on"},
                                                         {"gpu", "GPU"},
                                                         {"gpu_memory_gb", "GPU memory, GB"},
                                                         {"cuda", "CUDA"},
                                                         {"libtorch", "LibTorch"}};
  for (const auto& [key, value] : machine.items()) {
    const auto name = kNames.find(key);
    const std::string text = value.is_number() ? format_figure(value.get<double>()) : option_text(value);
    rows.push_back({name == kNames.end() ? without_underscores(key) : name->second, text});
  }
  return html::table({}, rows, html::Columns::kWords);
}

}  // namespace b3dgs
