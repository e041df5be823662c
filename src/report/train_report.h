// report.html of one training, from what its model folder holds.
#pragma once

#include <filesystem>

#include "model/model_folder.h"

namespace b3dgs {

/// Writes MODEL/report.html and returns its path. @throws InputError if the folder holds no training, IoError
std::filesystem::path write_train_report(const ModelFolder& folder);

}  // namespace b3dgs
