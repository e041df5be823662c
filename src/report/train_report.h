// report.html of one training, from the files in its model folder.
#pragma once

#include <filesystem>

#include "model/model_folder.h"

namespace b3dgs {

/// Writes MODEL/report.html and returns its path. @throws InputError if the folder holds no training; IoError
std::filesystem::path write_train_report(const ModelFolder& folder);

}  // namespace b3dgs
