// Keeps the model that a training with --overwrite replaces, until the new one is complete.
#pragma once

#include <filesystem>
#include <vector>

#include "app/common/status_line.h"
#include "model/model_folder.h"

namespace b3dgs {

/// @throws InputError if put_model_aside() could not move a part of the model in one step, because it is a link or on
/// another disk
void require_movable(const ModelFolder& folder);

/// Moves the files of an earlier training to replaced/, where they stay until drop_replaced_model(), so that they are
/// not mistaken for those of a new one. If replaced/ already has a model, because the training after it was stopped too
/// early, that model stays and the unfinished one is removed. Files that the program has not written, or that have
/// changed since, stay. Any that would be mistaken are moved to set_aside/replaced_1 (_2, _3, ...), which a warning
/// names. @throws as require_movable(), before anything is moved
void put_model_aside(const ModelFolder& folder, StatusLine& status);

/// Moves the program's own files among `parts` of a folder to replaced/ in it, but keeps existing files there.
void put_aside(const std::filesystem::path& folder, const std::vector<std::filesystem::path>& parts);

/// Removes the files that these functions have kept in a folder, after the new model is complete.
void drop_replaced_model(const std::filesystem::path& folder);

}  // namespace b3dgs
