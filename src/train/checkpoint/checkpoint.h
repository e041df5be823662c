// Reads and writes the training state.
#pragma once

#include <filesystem>
#include <functional>
#include <string>
#include <utility>
#include <vector>

#include <nlohmann/json.hpp>

#include "config/train_config.h"
#include "model/model_folder.h"
#include "scene/scene.h"
#include "train/checkpoint/train_state.h"

namespace b3dgs {

struct Checkpoint {
  TrainConfig config;
  TrainState state;
};

/// The header of a checkpoint, without the list of tensors.
nlohmann::ordered_json checkpoint_header(const TrainConfig& config, const TrainState& state,
                                         const nlohmann::ordered_json& fingerprint);

/// Names and tensors of a state, in file order.
std::vector<std::pair<std::string, torch::Tensor>> checkpoint_tensors(const TrainState& state);

/// Bytes of these tensors, with the rows of all ranks.
std::int64_t checkpoint_bytes(const TrainState& state);

/// @throws InputError if a checkpoint with these options, of this iteration, cannot be resumed with `wanted`
void check_resume_options(const TrainConfig& saved, int iteration, const TrainConfig& wanted, const std::string& place);

/// @throws IoError
void write_checkpoint(const std::filesystem::path& path, const TrainConfig& config, const TrainState& state,
                      const Scene& scene);

/// Reads a checkpoint onto `device`. @throws InputError with the reason if the file is damaged or was trained on other
/// views than the scene's
Checkpoint read_checkpoint(const std::filesystem::path& path, const Scene& scene, torch::Device device);

/// Removes what the checkpoint of `iteration`, just written, makes superfluous: of the training `training_id` all but
/// the newest `keep` up to it. Checkpoints of other trainings, later ones and damaged ones stay.
void remove_superseded_checkpoints(const ModelFolder& folder, const std::string& training_id, int iteration, int keep);

/// The newest valid checkpoint of the folder, or an empty path. Damaged ones are reported to `on_message`.
std::filesystem::path newest_valid_checkpoint(const ModelFolder& folder,
                                              const std::function<void(const std::string&)>& on_message);

}  // namespace b3dgs
