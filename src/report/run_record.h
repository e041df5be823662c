// What a report needs of a training beyond its log: MODEL/report/run.json and small pictures beside it. With them,
// report.html can be written again at any time, without scene or device.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include <nlohmann/json.hpp>

#include "model/model_folder.h"
#include "scene/scene.h"
#include "train/trainer.h"

namespace b3dgs {

/// A view with its photograph and its render, both small.
struct Preview {
  std::string view;
  double psnr = 0;                      // dB, of the view at its full size
  std::filesystem::path truth, render;  // PNG
};

struct RunRecord {
  nlohmann::ordered_json machine = nlohmann::ordered_json::object();
  double reading_s = 0;   // of the scene, all sessions
  double output_s = 0;    // evaluation, saving and checkpoints, all sessions
  int iteration = 0;      // last one done
  bool held_out = false;  // the previews are of test views
  std::vector<Preview> previews;
};

/// An empty record if there is none, or a damaged one: it is no reason to fail.
RunRecord read_run_record(const ModelFolder& folder);

/// Renders up to three views (of the held-out ones, if there are any) with the model as it stands and writes them into
/// the record. For TrainHooks::on_result: later an opacity reset may have made them dark. @throws IoError
void record_previews(Trainer& trainer, const Scene& scene, const ModelFolder& folder);

/// What one session of a training adds to the record.
struct SessionRecord {
  nlohmann::ordered_json machine;
  double reading_s = 0;
  TrainResult result;
};

/// Adds a session, and the views if there are none of this iteration: an interrupted training has not come to them.
/// @throws IoError
void record_session(const SessionRecord& session, Trainer& trainer, const Scene& scene, const ModelFolder& folder);

void remove_run_record(const ModelFolder& folder);

}  // namespace b3dgs
