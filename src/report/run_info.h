// What a report needs from a training besides its log: MODEL/report/run.json and small images beside it. With these,
// report.html can be written again without the scene and without a GPU.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include <nlohmann/json.hpp>

#include "model/model_folder.h"

namespace b3dgs {

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
  int iteration = 0;      // at which the previews were rendered
  bool held_out = false;  // the previews show test views
  std::vector<Preview> previews;
};

/// Returns an empty RunInfo if run.json is missing or damaged: the report then leaves those parts out.
RunInfo read_run_info(const ModelFolder& folder);

/// MODEL/report
std::filesystem::path report_folder(const ModelFolder& folder);

/// @throws IoError
void write_run_info(const RunInfo& info, const ModelFolder& folder);

}  // namespace b3dgs
