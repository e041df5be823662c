#include "report/page_data.h"

#include <algorithm>
#include <filesystem>
#include <fstream>
#include <optional>
#include <set>
#include <utility>

#include "adaptive/load_statistics.h"
#include "config/train_options.h"
#include "core/check.h"
#include "core/files/atomic_file.h"
#include "core/text.h"
#include "model/cameras/cameras_json.h"
#include "scene/images/image.h"

namespace b3dgs {
namespace {

using Json = nlohmann::ordered_json;

template <class Value>
Json to_json(const std::optional<Value>& value) {
  return value ? Json(*value) : Json(nullptr);
}

Json to_json(const NamedTimes& times) {
  Json json = Json::object();
  for (const auto& [name, ms] : times) json[name] = ms;
  return json;
}

Json to_json(const std::optional<LoadFigures>& load) {
  if (!load) return nullptr;
  Json json;
  visit_load_figures(*load, [&](const char* name, const auto& value) { json[name] = value; });
  return json;
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
      if (stage == sums.end()) stage = sums.insert(stage, {name, 0});
      stage->second += ms;
    }
  }
  for (auto& [name, ms] : sums) ms /= n;
  return sums;
}

Json curves_of(const TrainHistory& history) {
  Json curves = {{"iteration", Json::array()}, {"elapsed_s", Json::array()}, {"ms", Json::array()},
                 {"loss", Json::array()},      {"count", Json::array()},     {"test_psnr", Json::array()},
                 {"test_ssim", Json::array()}, {"kernel", Json::array()},    {"backward_kernel", Json::array()}};
  for (const LogPoint& point : history.points) {
    curves["iteration"].push_back(point.iteration);
    curves["elapsed_s"].push_back(point.elapsed_s);
    curves["ms"].push_back(to_json(point.ms));
    curves["loss"].push_back(to_json(point.loss));
    curves["count"].push_back(to_json(point.count));
    curves["test_psnr"].push_back(to_json(point.test_psnr));
    curves["test_ssim"].push_back(to_json(point.test_ssim));
    curves["kernel"].push_back(point.kernel);
    curves["backward_kernel"].push_back(point.backward_kernel);
  }
  return curves;
}

Json checks_of(const TrainHistory& history) {
  Json checks = Json::array();
  for (const KernelCheckEvent& check : history.checks) {
    checks.push_back({{"iteration", check.iteration},
                      {"pass", check.pass},
                      {"times_ms", to_json(check.times_ms)},
                      {"spread_ms", to_json(check.spread_ms)},
                      {"views", to_json(check.views)},
                      {"before", check.before},
                      {"after", check.after},
                      {"reason", check.reason},
                      {"refused", check.disabled},
                      {"cost_ms", to_json(check.cost_ms)},
                      {"warm_up_ms", to_json(check.warm_up_ms)}});
  }
  return checks;
}

Json loads_of(const TrainHistory& history) {
  Json loads = Json::array();
  for (const LoadEvent& own : history.loads) {
    loads.push_back({{"iteration", own.iteration},
                     {"tile_lists", to_json(own.tile_lists)},
                     {"pixel_processed", to_json(own.pixel_processed)},
                     {"pixel_contributing", to_json(own.pixel_contributing)}});
  }
  return loads;
}

/// "" if the file has been deleted since: the report is written without it.
std::string picture(const std::filesystem::path& file) {
  return std::filesystem::exists(file) ? data_uri(read_image(file, false)) : "";
}

}  // namespace

Json history_json(const TrainHistory& history) {
  return {{"stages_ms", to_json(mean_stages(history))},
          {"curves", curves_of(history)},
          {"kernel_checks", checks_of(history)},
          {"load_statistics", loads_of(history)}};
}

Json run_data(const std::string& name, std::int64_t seed, const TrainHistory& history) {
  Json run = {{"name", name}, {"seed", seed}};
  run.update(history_json(history));
  for (const char* of_no_chart : {"ms", "kernel", "backward_kernel"}) run["curves"].erase(of_no_chart);
  Json times = Json::array(), periods = Json::array(), resumes = Json::array();
  for (const CandidateTimes& own : history.candidate_times) {
    times.push_back({{"iteration", own.iteration}, {"pass", own.pass}, {"times_ms", to_json(own.times_ms)}});
  }
  for (const KernelPeriod& own : kernel_periods(history)) {
    periods.push_back({{"kernel", own.kernel}, {"from", own.from}, {"until", own.until}});
  }
  for (const ResumeEvent& own : history.resumes) {
    resumes.push_back({{"iteration", own.iteration},
                       {"kernel", own.kernel},
                       {"backward_kernel", own.backward_kernel},
                       {"changed_options", own.changed_options}});
  }
  run.update({{"candidate_times", times}, {"kernel_periods", periods}, {"resumes", resumes}});
  return run;
}

Json previews_data(const std::vector<NamedInfo>& runs) {
  Json previews = Json::array();
  const std::vector<Preview>& views = runs.front().info.previews;
  for (std::size_t i = 0; i < views.size(); ++i) {
    Json renders = Json::array();
    for (const NamedInfo& run : runs) {
      if (i >= run.info.previews.size()) continue;
      const Preview& own = run.info.previews[i];
      renders.push_back({{"name", run.name}, {"psnr", own.psnr}, {"image", picture(own.render)}});
    }
    previews.push_back({{"view", views[i].view}, {"photograph", picture(views[i].photograph)}, {"renders", renders}});
  }
  return previews;
}

std::string option_text(const Json& value) {
  if (value.is_string()) return value.get<std::string>();
  if (!value.is_array()) return value.dump();
  std::string text;
  for (const auto& entry : value) text += (text.empty() ? "" : " ") + option_text(entry);
  return text.empty() ? "none" : text;
}

std::string changed_options(const TrainConfig& base, const TrainConfig& own) {
  static const std::set<std::string> kShownElsewhere{"source_path", "model_path", "device"};
  const Json before = config_to_json(base), after = config_to_json(own);
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

namespace {

namespace fs = std::filesystem;
using Json = nlohmann::ordered_json;

Json to_json(const RunInfo& info) {
  Json previews = Json::array();
  for (const Preview& preview : info.previews) {
    previews.push_back({{"view", preview.view},
                        {"psnr", preview.psnr},
                        {"truth", preview.photograph.filename().string()},
                        {"render", preview.render.filename().string()}});
  }
  return {{"iteration", info.iteration}, {"reading_s", info.reading_s}, {"output_s", info.output_s},
          {"machine", info.machine},     {"held_out", info.held_out},   {"previews", previews}};
}

}  // namespace

fs::path report_folder(const ModelFolder& folder) {
  return folder.root() / "report";
}

void write_run_info(const RunInfo& info, const ModelFolder& folder) {
  write_file(report_folder(folder) / "run.json",
             to_json(info).dump(2, ' ', false, Json::error_handler_t::replace) + "\n");
}

RunInfo read_run_info(const ModelFolder& folder) {
  std::ifstream file(report_folder(folder) / "run.json");
  const Json json = Json::parse(file, nullptr, /*allow_exceptions=*/false);
  RunInfo info;
  if (!json.is_object()) return info;
  try {
    info.machine = json.value("machine", Json::object());
    info.reading_s = json.value("reading_s", 0.0);
    info.output_s = json.value("output_s", 0.0);
    info.iteration = json.value("iteration", 0);
    info.held_out = json.value("held_out", false);
    for (const Json& preview : json.value("previews", Json::array())) {
      info.previews.push_back({preview.at("view"), preview.value("psnr", 0.0),
                               report_folder(folder) / preview.at("truth").get<std::string>(),
                               report_folder(folder) / preview.at("render").get<std::string>()});
    }
  } catch (const nlohmann::json::exception&) {
    return {};
  }
  return info;
}

}  // namespace b3dgs
