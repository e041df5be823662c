// Training state on disk: what is in a checkpoint file, and whether it belongs to a scene.
#pragma once

#include <filesystem>
#include <functional>
#include <string>
#include <utility>
#include <vector>

#include <nlohmann/json.hpp>

#include "model/model_folder.h"
#include "scene/scene.h"
#include "train/checkpoint/train_state.h"
#include "train/config/train_config.h"

namespace b3dgs {

struct Checkpoint {
  TrainConfig config;
  TrainState state;
};

/// What has to be equal for view indices and image sizes to mean the same; and what tells whether a photograph is still
/// the one that was trained on: its size in bytes and the CRC-32 of its first 64 KiB.
nlohmann::ordered_json scene_fingerprint(const Scene& scene);

/// Header of a checkpoint, but for its tensors.
nlohmann::ordered_json checkpoint_header(const TrainConfig& config, const TrainState& state,
                                         const nlohmann::ordered_json& fingerprint);

/// Names and tensors of a state, in the order of the file.
std::vector<std::pair<std::string, torch::Tensor>> checkpoint_tensors(const TrainState& state);

/// @throws InputError if a checkpoint with this header was trained on other views than the scene's, which need no
/// images
void check_scene(const nlohmann::ordered_json& header, const Scene& scene, const std::string& place);

/// Names of training views whose photographs have changed since a checkpoint with this header was written, as far as it
/// tells.
std::vector<std::string> changed_photographs(const nlohmann::ordered_json& header,
                                             const nlohmann::ordered_json& fingerprint);

/// @throws IoError
void write_checkpoint(const std::filesystem::path& path, const TrainConfig& config, const TrainState& state,
                      const Scene& scene);

/// Reads a checkpoint onto `device`. @throws InputError with the reason if the file is damaged or was trained on other
/// views than the scene's
Checkpoint read_checkpoint(const std::filesystem::path& path, const Scene& scene, torch::Device device);

/// Removes what the checkpoint of `iteration`, just written, makes superfluous: of the training `training_id` all but
/// the newest `keep` up to it. Checkpoints of other trainings, later ones and damaged ones stay.
void remove_superseded_checkpoints(const ModelFolder& folder, const std::string& training_id, int iteration, int keep);

/// The newest checkpoint of the folder that can be read, or nothing; damaged ones are reported to `on_message` with the
/// reason.
std::filesystem::path newest_valid_checkpoint(const ModelFolder& folder,
                                              const std::function<void(const std::string&)>& on_message);

}  // namespace b3dgs
