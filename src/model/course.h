// Whose files a model folder holds. A course of training has an id, which stands in the folder's course.json and in
// each of its checkpoints, so that no training goes on where another one's model lies. Nor does a training that goes
// back to an earlier checkpoint overwrite what it left behind: that is set aside.
#pragma once

#include <filesystem>
#include <string>

#include "model/model_folder.h"

namespace b3dgs {

/// 16 random hexadecimal digits.
std::string new_course_id();

/// Whether `folder` holds no model, or that of a checkpoint of `course` (empty: written by an early version, and of the
/// folder in which it lies).
bool has_room_for(const ModelFolder& folder, const std::filesystem::path& checkpoint, const std::string& course);

/// @throws InputError if it does not.
void check_course(const ModelFolder& folder, const std::filesystem::path& checkpoint, const std::string& course);

/// The course that goes on from such a checkpoint in `folder`: the folder's own, or a new one if it has none.
std::string course_in(const ModelFolder& folder);

/// What the model folder holds of iterations after `iteration`: checkpoints, PLYs, images, results, lines of the log
/// and the report of these. Moves all of it to a new folder set_aside/after_iteration_N_1 (2, 3, ... if that is taken),
/// which is returned. Lines of the log alone are no reason for that: nothing is moved and the result is empty.
/// @throws IoError
std::filesystem::path set_aside_after(const ModelFolder& folder, int iteration);

}  // namespace b3dgs
