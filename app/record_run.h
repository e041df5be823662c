// What a report needs of a training beyond its log (report/page_data.h): the machine, and what is written while the
// training runs.
#pragma once

#include <torch/types.h>
#include <nlohmann/json.hpp>

#include "dist/communicator.h"
#include "model/model_folder.h"
#include "scene/scene.h"
#include "train/trainer.h"

namespace b3dgs {

/// To store along with measured times. Keys: "program", "cpu", "cores" (logical), "memory_gb", "libtorch", "device"; if
/// `device` is a GPU also "gpu", "gpu_memory_gb", "driver" and "cuda". Unknown values are omitted.
nlohmann::ordered_json describe_machine(const torch::Device& device);

/// Renders up to three views (test views if there are any) and saves them for the report. To be called from
/// TrainHooks::on_result, because an opacity reset may follow, which would make the images dark. Of several ranks, all
/// call this together, since rendering may need all of them, and rank 0 writes. @throws IoError
void record_previews(Trainer& trainer, const Scene& scene, const ModelFolder& folder, Communicator& ranks);

/// Adds a session, and the views if record_previews() was not called at this iteration, as in an interrupted training.
/// `machine`: describe_machine(). All ranks call this together, and rank 0 writes. @throws IoError
void record_session(const nlohmann::ordered_json& machine, double reading_s, double output_s, Trainer& trainer,
                    const Scene& scene, const ModelFolder& folder, Communicator& ranks);

}  // namespace b3dgs
