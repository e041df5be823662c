#include "app/report/train_report.h"

#include <algorithm>

#include "app/report/page_data.h"
#include "config/option_layers.h"
#include "config/train_options.h"
#include "core/check.h"
#include "core/files/atomic_file.h"
#include "core/text.h"

namespace b3dgs {
namespace {

using Json = nlohmann::ordered_json;

/// Returns the last point with an evaluation on test views, or null.
const LogPoint* last_evaluation(const TrainHistory& history) {
  for (auto point = history.points.rbegin(); point != history.points.rend(); ++point) {
    if (point->test_psnr) return &*point;
  }
  return nullptr;
}

/// Returns 0 if GPU memory was not measured.
std::int64_t gpu_peak_bytes(const TrainHistory& history) {
  std::int64_t peak = 0;
  for (const LogPoint& point : history.points) peak = std::max(peak, point.gpu_peak_bytes.value_or(0));
  return peak;
}

/// Returns pairs of name and text.
Json settings(const ModelFolder& folder, const TrainConfig& config) {
  Json rows = scene_rows(config, folder);
  const std::string changed = changed_options(config_to_json(preset_options(config)), config_to_json(config));
  const std::string preset = "--preset " + config.preset + ", --strategy " + name_of(config.strategy);
  rows.push_back({"options", changed.empty() ? "those of " + preset : changed + "; otherwise those of " + preset});
  return rows;
}

/// Returns the event after which memory or an option has limited the number of Gaussians, or null.
Json limit_of(const TrainHistory& history) {
  const Json& held = history.events["capped"];
  if (held.empty() || history.points.empty()) return nullptr;
  return history.points.back().count.value_or(0) > held.back()["count"] ? Json(nullptr) : held.back();
}

Json overfitting_of(const TrainHistory& history) {
  const std::optional<Overfitting> found = find_overfitting(history);
  return found ? Json{{"iteration", found->iteration}, {"lost", found->lost}} : Json(nullptr);
}

}  // namespace

std::string floaters_text(const TrainHistory& history) {
  const Json& events = history.events["floaters"];
  if (events.empty() || events.back()["iteration"] < history.last_iteration()) return "";
  const auto count = [&](const char* key) { return format_count(events.back()[key]); };
  return count("unseen") + " in no training view, " + count("one_view") + " in one only, " + count("close") +
         " close to a camera, " + count("large") + " large in an image";
}

std::string limit_text(const TrainHistory& history, std::int64_t limit) {
  constexpr double kNearly = 0.95, kSoft = 0.9;
  const LogPoint *most = nullptr, *last = nullptr;
  for (const LogPoint& point : history.points) {
    if (!point.count) continue;
    last = &point;
    if (most == nullptr || *point.count > *most->count) most = &point;
  }
  const double nearly = kNearly * static_cast<double>(limit);
  if (limit == 0 || last == nullptr) return "";
  if (static_cast<double>(*last->count) >= nearly) {
    const LogPoint* const measured = last_evaluation(history);
    return "growth ended at the limit of " + format_count(limit) +
           (measured != nullptr && measured->test_sharpness.value_or(1) < kSoft
                ? print_to_string(", and the test views are rendered with %.2f of the sharpness of their photographs",
                                  *measured->test_sharpness)
                : "") +
           "; a higher --max_gaussians allows more";
  }
  const std::string there_were = format_count(*most->count) + " after iteration " + format_count(most->iteration);
  if (static_cast<double>(*most->count) < nearly) {
    return "the limit of " + format_count(limit) + " was not reached: at most " + there_were;
  }
  return "of " + there_were + ", those that hardly contribute were removed";
}

std::optional<Overfitting> find_overfitting(const TrainHistory& history) {
  constexpr double kClear = 0.2;  // dB; PSNR also fluctuates without a trend
  const LogPoint* const last = last_evaluation(history);
  const LogPoint* best = last;
  for (const LogPoint& point : history.points) {
    if (point.test_psnr && *point.test_psnr > *best->test_psnr) best = &point;
  }
  if (last == nullptr || *best->test_psnr - *last->test_psnr <= kClear) return std::nullopt;
  return Overfitting{best->iteration, *best->test_psnr - *last->test_psnr};
}

nlohmann::ordered_json train_report_data(const ModelFolder& folder) {
  const TrainConfig config = folder.read_config();
  const TrainHistory history = read_train_log(folder.log());
  const RunInfo info = read_run_info(folder);
  const std::string scene = scene_name(config.source_path);
  return {{"kind", "training"},
          {"scene", scene},
          {"iterations", config.iterations},
          {"held_out", info.held_out},
          {"measures_half", config.train_test_exp},
          {"overfitting", overfitting_of(history)},
          {"limit", limit_of(history)},
          {"floaters", floaters_text(history)},
          {"reading_s", info.reading_s},
          {"output_s", info.output_s},
          {"gpu_peak_bytes", gpu_peak_bytes(history)},
          {"settings", settings(folder, config)},
          {"machine", info.machine},
          {"previews", previews_data({{scene, info}})},
          {"runs", Json::array({run_data(scene, config.seed, history)})}};
}

std::filesystem::path write_train_report(const ModelFolder& folder) {
  const std::filesystem::path path = folder.root() / "report.html";
  write_file(path, report_page(train_report_data(folder)));
  return path;
}

}  // namespace b3dgs
