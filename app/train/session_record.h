// Data that a training saves for its report beyond the log (app/report/page_data.h): views, and the sessions.
#pragma once

#include <nlohmann/json.hpp>

#include "dist/communicator.h"
#include "model/model_folder.h"
#include "scene/scene.h"
#include "train/trainer.h"

namespace b3dgs {

/// Renders up to three views (test views if there are any) and saves them for the report. Call this from
/// TrainHooks::on_last_files_written, because a later opacity reset would make the images dark. With several ranks, all
/// call this together, because rendering may need all of them, and rank 0 writes. @throws IoError
void record_previews(Trainer& trainer, const Scene& scene, const ModelFolder& folder, Communicator& ranks);

/// Adds a session, and the views if record_previews() was not called at this iteration, as in an interrupted training.
/// `machine`: describe_machine() (app/common/torch/machine.h). All ranks call this together, and rank 0 writes. @throws
/// IoError
void record_session(const nlohmann::ordered_json& machine, double reading_s, double output_s, Trainer& trainer,
                    const Scene& scene, const ModelFolder& folder, Communicator& ranks);

}  // namespace b3dgs
