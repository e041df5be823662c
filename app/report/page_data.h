// Parts shared by the reports of trainings and comparisons: the files that they show beside a model, their data (JSON),
// and the page.
#pragma once

#include <cstdint>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "app/report/train_log_reader.h"
#include "core/text.h"
#include "model/model_folder.h"
#include "scene/images/image.h"

namespace b3dgs {

/// Returns "12.3 s", or "3.21 s" if `smallest`, the smallest of the times shown together, is below 10.
inline std::string format_seconds(double value, double smallest) {
  return print_to_string(smallest < 10 ? "%.2f s" : "%.1f s", value);
}

// Data for a report beyond the log of a training: MODEL/report/run.json and small images beside it. With these,
// report.html can be written again without the scene and without a GPU.

/// Thumbnails of a photograph and of its render.
struct Preview {
  std::string view;
  double psnr = 0;                           // dB, at full resolution
  std::filesystem::path photograph, render;  // PNG files
};

struct RunInfo {
  nlohmann::ordered_json machine = nlohmann::ordered_json::object();
  double reading_s = 0;   // reading the scene, sum over all sessions
  double output_s = 0;    // evaluation, saving and checkpoints, sum over all sessions
  int iteration = 0;      // iteration of the previews
  bool held_out = false;  // the previews show test views
  std::vector<Preview> previews;
};

/// Returns an empty RunInfo if run.json is missing or damaged, so that the report leaves those parts out. @throws
/// InputError if it names pictures outside of its folder
RunInfo read_run_info(const ModelFolder& folder);

/// In the folder of a comparison.
inline constexpr const char* kComparisonFile = "compare.json";
bool holds_comparison(const std::filesystem::path& root);

/// Returns MODEL/report.
std::filesystem::path report_folder(const ModelFolder& folder);

/// @throws IoError
void write_run_info(const RunInfo& info, const ModelFolder& folder);

// report.html, a single file without external resources. The program writes the data, and page/ draws it.

/// Returns the page that shows `data`, with "kind" training or comparison. Any text in `data` is safe, including broken
/// UTF-8 and HTML. Fractions are rounded to 6 digits.
std::string report_page(nlohmann::ordered_json data);

/// Returns the image as JPEG in a data URI. @throws IoError if it cannot be encoded
std::string data_uri(const Image8& rgb);

// The parts of a report's data (JSON) shared by trainings and comparisons. page/ reads them.

/// Returns a run for compare.json: "stages_ms" (mean per step), "curves" (an array per quantity, null where it was not
/// measured), "kernel_checks" and "load_statistics".
nlohmann::ordered_json history_json(const TrainHistory& history);

/// Returns a run as the page draws it: its name and seed, history_json(), "kernel_periods" and "resumes".
nlohmann::ordered_json run_data(const std::string& name, std::int64_t seed, const TrainHistory& history);

/// Returns one entry per view: the photograph and the renders of all runs, as data URIs. An image is "" if it is
/// missing or damaged.
struct NamedInfo {
  std::string name;
  const RunInfo& info;
};
nlohmann::ordered_json previews_data(const std::vector<NamedInfo>& runs);

/// Returns the value as on the command line, but only the last part of a path.
std::string option_text(const nlohmann::ordered_json& value);

/// Returns "eval on, seed 7": options (config_to_json()) in which `own` differs from `base`, without scene, model
/// folder and device, or "" if there are none.
std::string changed_options(const nlohmann::ordered_json& base, const nlohmann::ordered_json& own);

/// Returns the first settings in a report, pairs of name and text: the scene and, if the model's cameras.json can be
/// read, the resolution of its photographs.
nlohmann::ordered_json scene_rows(const TrainConfig& config, const ModelFolder& folder);

}  // namespace b3dgs
