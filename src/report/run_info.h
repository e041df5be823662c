// What a report needs of a training beyond its log: MODEL/report/run.json and small pictures beside it. With them,
// report.html can be written again at any time, without scene or device.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include <nlohmann/json.hpp>

#include "model/model_folder.h"

namespace b3dgs {

/// A view with its photograph and its render, both small.
struct Preview {
  std::string view;
  double psnr = 0;                      // dB, of the view at its full size
  std::filesystem::path truth, render;  // PNG
};

struct RunInfo {
  nlohmann::ordered_json machine = nlohmann::ordered_json::object();
  double reading_s = 0;   // of the scene, all sessions
  double output_s = 0;    // evaluation, saving and checkpoints, all sessions
  int iteration = 0;      // last one done
  bool held_out = false;  // the previews are of test views
  std::vector<Preview> previews;
};

/// An empty record if there is none, or a damaged one: it is no reason to fail.
RunInfo read_run_info(const ModelFolder& folder);

std::filesystem::path report_folder(const ModelFolder& folder);

/// @throws IoError
void write_run_info(const RunInfo& record, const ModelFolder& folder);

void remove_run_info(const ModelFolder& folder);

}  // namespace b3dgs
