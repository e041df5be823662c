// Writes what a report needs of a training beyond its log (report/run_info.h), while the training runs.
#pragma once

#include <nlohmann/json.hpp>

#include "model/model_folder.h"
#include "scene/scene.h"
#include "train/trainer.h"

namespace b3dgs {

/// Renders up to three views (test views if there are any) and saves them for the report. To be called from
/// TrainHooks::on_result, because an opacity reset may follow, which would make the images dark. @throws IoError
void record_previews(Trainer& trainer, const Scene& scene, const ModelFolder& folder);

/// What one session adds.
struct SessionRecord {
  nlohmann::ordered_json machine;
  double reading_s = 0;
  TrainResult result;
};

/// Adds a session, and the views if record_previews() was not called at this iteration, as in an interrupted training.
/// @throws IoError
void record_session(const SessionRecord& session, Trainer& trainer, const Scene& scene, const ModelFolder& folder);

}  // namespace b3dgs
