// Training state on disk: what is in a checkpoint file, and whether it belongs to a scene.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "scene/scene.h"
#include "train/model_folder.h"
#include "train/train_config.h"
#include "train/train_state.h"

namespace b3dgs {

struct Checkpoint {
  TrainConfig config;
  TrainState state;
};

/// @throws IoError
void write_checkpoint(const std::filesystem::path& path, const TrainConfig& config, const TrainState& state,
                      const Scene& scene);

/// Reads a checkpoint onto `device`. @throws InputError with the reason if the file is damaged or was trained on other
/// views than the scene's
Checkpoint read_checkpoint(const std::filesystem::path& path, const Scene& scene, torch::Device device);

/// Removes what the checkpoint of `iteration`, just written, makes superfluous: all but the newest `keep` up to it, and
/// those of later iterations, which belong to a course that this run has left.
void remove_superseded_checkpoints(const ModelFolder& folder, int iteration, int keep);

}  // namespace b3dgs
