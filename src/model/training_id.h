// Which training the files of a model folder belong to. Every training has a random ID, stored in the folder's
// training.json and in each of its checkpoints, so that no training continues in a folder that holds another's model.
#pragma once

#include <filesystem>
#include <string>

#include "model/model_folder.h"

namespace b3dgs {

/// 16 random hexadecimal digits.
std::string new_training_id();

/// Whether a training may be resumed in `folder` from a checkpoint with this training ID: the folder holds no model, or
/// one of the same training. A folder or checkpoint of an early version has no ID (""): then the checkpoint has to be
/// one of the folder's own.
bool may_continue_in(const ModelFolder& folder, const std::filesystem::path& checkpoint,
                     const std::string& training_id);

/// @throws InputError unless may_continue_in().
void check_training_id(const ModelFolder& folder, const std::filesystem::path& checkpoint,
                       const std::string& training_id);

/// For a training that begins. @throws InputError if the folder holds a model
void check_holds_no_model(const ModelFolder& folder);

/// The ID of a training that is resumed in `folder`: the folder's own, or a new one if the folder holds no model or has
/// no ID.
std::string training_id_for(const ModelFolder& folder);

}  // namespace b3dgs
