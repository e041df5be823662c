// Finds the COLMAP model in a scene folder.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "scene/colmap/colmap.h"

namespace b3dgs {

struct SparseModelFolder {
  std::filesystem::path folder;
  ColmapFormat format = ColmapFormat::kBinary;
  std::vector<std::string> notes;  // which model was chosen, and errors of others
};

/// Whether the scene folder holds a COLMAP model, complete or not.
bool has_model_folder(const std::filesystem::path& source);

/// Searches sparse/N, sparse/ and the scene folder itself; of several models, chooses the one with the most images.
/// @throws InputError if there is none
SparseModelFolder find_model_folder(const std::filesystem::path& source);

}  // namespace b3dgs
