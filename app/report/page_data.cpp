#include "app/report/page_data.h"

#include <cmath>
#include <cstdint>
#include <cstdlib>
#include <filesystem>
#include <optional>
#include <set>
#include <utility>

#include "config/option_layers.h"
#include "core/check.h"
#include "core/files/atomic_file.h"
#include "core/files/json_file.h"
#include "core/text.h"
#include "model/cameras/cameras_json.h"
#include "scene/images/image.h"

namespace b3dgs {
namespace {

using Json = nlohmann::ordered_json;

Json or_null(const std::optional<double>& value) {
  return value ? Json(*value) : Json(nullptr);
}
Json or_null(const std::optional<std::int64_t>& value) {
  return value ? Json(*value) : Json(nullptr);
}
template <class Value>
Json or_null(const Value& value) {
  return value;
}

/// Returns the name without its location, because reports are passed on.
std::string last_part(std::string path) {
  while (path.size() > 1 && path.back() == '/') path.pop_back();
  return path.substr(path.rfind('/') + 1);
}

/// Applies last_part() to quoted text: masks: "" -> "/data/masks".
std::string with_last_parts(const std::string& change) {
  std::string text;
  for (std::size_t at = 0;;) {
    const std::size_t open = change.find('"', at), close = change.find('"', open + 1);
    if (open == std::string::npos || close == std::string::npos) return text + change.substr(at);
    text += change.substr(at, open + 1 - at) + last_part(change.substr(open + 1, close - open - 1)) + '"';
    at = close + 1;
  }
}

Json mean_stages(const TrainHistory& history) {
  Json means = Json::object();
  double n = 0;
  for (const LogPoint& point : history.points) {
    n += point.stages_ms.empty() ? 0 : 1;
    for (const auto& [name, ms] : point.stages_ms.items()) means[name] = means.value(name, 0.0) + ms.get<double>();
  }
  for (Json& ms : means) ms = ms.get<double>() / n;
  return means;
}

Json curves_of(const TrainHistory& history) {
  Json curves;
  const LogPoint none;
  LogPoint::visit_curves(none, [&](const char* key, const auto&) { curves[key] = Json::array(); });
  for (const LogPoint& point : history.points) {
    LogPoint::visit_curves(point, [&](const char* key, const auto& value) { curves[key].push_back(or_null(value)); });
  }
  return curves;
}

/// Returns "" if the file is not a readable image, and the report is written without it.
std::string picture(const std::filesystem::path& file) {
  if (!std::filesystem::exists(file)) return "";  // also if no file was named
  try {
    return data_uri(read_image(file, false));
  } catch (const InputError&) {
    return "";
  }
}

/// Returns "24 photographs, 240 x 160 px", from the model's cameras.json, or "" if that cannot be read.
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

}  // namespace

Json history_json(const TrainHistory& history) {
  return {{"stages_ms", mean_stages(history)},
          {"curves", curves_of(history)},
          {"kernel_checks", history.events["kernel_check"]},
          {"load_statistics", history.events["load_statistics"]}};
}

Json run_data(const std::string& name, std::int64_t seed, const TrainHistory& history) {
  Json run = {{"name", name}, {"seed", seed}};
  run.update(history_json(history));
  for (const char* of_no_chart : {"ms", "kernel"}) run["curves"].erase(of_no_chart);
  Json periods = Json::array();
  for (const KernelPeriod& own : kernel_periods(history)) {
    periods.push_back({{"kernel", own.kernel}, {"from", own.from}, {"until", own.until}});
  }
  Json resumes = history.events["resumed"];
  for (Json& resume : resumes) {
    for (Json& change : resume["changed_options"]) change = with_last_parts(change.get<std::string>());
  }
  run.update({{"kernel_periods", periods}, {"resumes", resumes}});
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
      renders.push_back(
          {{"name", run.name}, {"iteration", run.info.iteration}, {"psnr", own.psnr}, {"image", picture(own.render)}});
    }
    previews.push_back({{"view", views[i].view}, {"photograph", picture(views[i].photograph)}, {"renders", renders}});
  }
  return previews;
}

std::string option_text(const Json& value) {
  return value.is_string() && value != "" ? last_part(value.get<std::string>()) : option_value_text(value);
}

std::string changed_options(const Json& base, const Json& own) {
  static const std::set<std::string> kShownElsewhere{"source_path", "model_path", "device"};
  std::string text;
  for (const auto& [name, value] : own.items()) {
    if (value == base.at(name) || kShownElsewhere.count(name) > 0) continue;
    text += (text.empty() ? "" : ", ") + name + " " + option_text(value);
  }
  return text;
}

Json scene_rows(const TrainConfig& config, const ModelFolder& folder) {
  Json rows = Json::array({Json::array({"source scene", scene_name(config.source_path)})});
  if (const std::string text = photographs_text(folder); !text.empty()) rows.push_back({"resolution", text});
  return rows;
}

namespace {

namespace fs = std::filesystem;

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

bool holds_comparison(const fs::path& root) {
  return fs::exists(root / kComparisonFile);
}

fs::path report_folder(const ModelFolder& folder) {
  return folder.root() / "report";
}

void write_run_info(const RunInfo& info, const ModelFolder& folder) {
  write_json_file(report_folder(folder) / "run.json", to_json(info));
}

RunInfo read_run_info(const ModelFolder& folder) {
  const fs::path file = report_folder(folder) / "run.json";
  const Json json = read_json(file);
  RunInfo info;
  if (!json.is_object()) return info;
  try {
    info.machine = json.value("machine", Json::object());
    info.reading_s = json.value("reading_s", 0.0);
    info.output_s = json.value("output_s", 0.0);
    info.iteration = json.value("iteration", 0);
    info.held_out = json.value("held_out", false);
    for (const Json& preview : json.value("previews", Json::array())) {
      const auto picture_at = [&](const char* key) -> fs::path {
        try {
          return file_in(report_folder(folder), preview.at(key).get<std::string>(), file.string() + ": " + key);
        } catch (const InputError&) {  // a link, or outside of the folder: the report is written without it
          return {};
        }
      };
      info.previews.push_back(
          {preview.at("view"), preview.value("psnr", 0.0), picture_at("truth"), picture_at("render")});
    }
  } catch (const nlohmann::json::exception&) {
    return {};
  }
  return info;
}

/// The contents of page/, which CMake combines into one string. The data replaces "@DATA@", as JSON.
extern const char* const kReportPage;

namespace {

void round_numbers(Json& json) {
  if (json.is_number_float()) {
    const auto value = json.get<double>();
    const char* const format = std::fabs(value) < 1e5 ? "%.6g" : "%.9g";  // means of counts stay exact
    json = std::strtod(print_to_string(format, value).c_str(), nullptr);
  }
  if (!json.is_structured()) return;
  for (Json& part : json) round_numbers(part);
}

std::string base64(const std::string& bytes) {
  constexpr char kDigits[] = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
  std::string text;
  std::uint32_t bits = 0;  // the last n bits are not in the text yet
  int n = 0;
  for (const char byte : bytes) {
    bits = bits << 8 | static_cast<unsigned char>(byte);
    for (n += 8; n >= 6; n -= 6) text += kDigits[bits >> (n - 6) & 63];
  }
  if (n > 0) text += kDigits[bits << (6 - n) & 63];
  return text + std::string((3 - bytes.size() % 3) % 3, '=');
}

}  // namespace

std::string report_page(Json data) {
  round_numbers(data);
  // The output is ASCII, and "<" occurs only in strings, so no text can end the script element or open a comment.
  const std::string json = data.dump(-1, ' ', /*ensure_ascii=*/true, Json::error_handler_t::replace);
  std::string page = kReportPage;
  const std::string mark = "@DATA@";
  std::string text;
  text.reserve(json.size());
  for (const char c : json) c == '<' ? text += "\\u003c" : text += c;
  return page.replace(page.find(mark), mark.size(), text);
}

std::string data_uri(const Image8& rgb) {
  constexpr int kQuality = 82;
  return "data:image/jpeg;base64," + base64(encode_jpeg(rgb, kQuality));
}

}  // namespace b3dgs
