// Writes what a report needs of a training beyond its log (report/run_info.h), while the training runs.
#pragma once

#include <nlohmann/json.hpp>

#include "model/model_folder.h"
#include "scene/scene.h"
#include "train/trainer.h"

namespace b3dgs {

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

}  // namespace b3dgs
