// Resuming from an earlier checkpoint overwrites nothing: files of later iterations are moved aside first.
#pragma once

#include <filesystem>

#include "model/model_folder.h"

namespace b3dgs {

/// Moves what the model folder holds of iterations after `iteration` (checkpoints, PLYs, rendered images, results,
/// lines of the log, and reports on them) to a new folder set_aside/after_iteration_N_1 (_2, _3, ... if that exists),
/// which is returned; empty if there is nothing of later iterations. @throws IoError
std::filesystem::path set_aside_after(const ModelFolder& folder, int iteration);

}  // namespace b3dgs
