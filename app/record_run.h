// Data for a report beyond the log of a training (report/page_data.h): the machine, and the files written while the
// training runs.
#pragma once

#include <torch/types.h>
#include <nlohmann/json.hpp>

#include "dist/communicator.h"
#include "model/model_folder.h"
#include "scene/scene.h"
#include "train/trainer.h"

namespace b3dgs {

/// Returns data to store with measured times. Keys: "program", "cpu", "cores" (logical), "memory_gb", "libtorch",
/// "device"; if `device` is a GPU also "gpu", "gpu_memory_gb", "driver" and "cuda". Unknown values are omitted.
nlohmann::ordered_json describe_machine(const torch::Device& device);

/// Renders up to three views (test views if there are any) and saves them for the report. Call this from
/// TrainHooks::on_result, because a later opacity reset would make the images dark. With several ranks, all call this
/// together, because rendering may need all of them, and rank 0 writes. @throws IoError
void record_previews(Trainer& trainer, const Scene& scene, const ModelFolder& folder, Communicator& ranks);

/// Adds a session, and the views if record_previews() was not called at this iteration, as in an interrupted training.
/// `machine`: describe_machine(). All ranks call this together, and rank 0 writes. @throws IoError
void record_session(const nlohmann::ordered_json& machine, double reading_s, double output_s, Trainer& trainer,
                    const Scene& scene, const ModelFolder& folder, Communicator& ranks);

}  // namespace b3dgs
