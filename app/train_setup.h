// Shared by `train` and `compare`: signals, paths and model folders.
#pragma once

#include <atomic>
#include <filesystem>
#include <string>

#include "model/model_folder.h"

namespace b3dgs {

/// The signal that asked the program to stop, or 0.
const std::atomic<int>& stop_signal();

/// From now on, the first SIGINT or SIGTERM makes training write a checkpoint and stop. A second one, at least half a
/// second later, ends the program immediately.
void catch_stop_signals();

/// Like the first Ctrl-C, however often it is called.
void request_stop();

/// Makes a path independent of the working folder. An empty path stays empty.
void make_absolute(std::string& path);

/// Removes the files of an earlier training from a model folder, so that they are not mistaken for those of a new one.
/// Files that the program has not written, or that were changed since, stay; where they would be mistaken, too, they
/// are moved to a folder set_aside/replaced_1 (_2, _3, ...), which is returned; otherwise the result is empty.
std::filesystem::path remove_model(const ModelFolder& folder);

/// @throws InputError if put_model_aside() could not move a part of the model in one step: a link, or on another disk
void require_movable(const ModelFolder& folder);

/// The same as remove_model(), but keeps the earlier model in replaced/ until drop_replaced_model(). A model that is
/// there already, from a training that was stopped before it had a model of its own, stays instead of an unfinished
/// one. @throws as require_movable(), before anything is moved
std::filesystem::path put_model_aside(const ModelFolder& folder);

/// Moves the program's own files among `parts` of a folder to replaced/ in it, but keeps what is there already.
void put_aside(const std::filesystem::path& folder, const std::vector<std::filesystem::path>& parts);

/// Removes what these have kept, once the new model is complete.
void drop_replaced_model(const ModelFolder& folder);

}  // namespace b3dgs
