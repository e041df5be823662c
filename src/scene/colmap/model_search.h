// Where in a scene folder the COLMAP model is.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "scene/colmap/colmap.h"

namespace b3dgs {

struct SparseModelFolder {
  std::filesystem::path folder;
  ColmapFormat format = ColmapFormat::kBinary;
  std::vector<std::string> notes;  // choices made for the user
};

/// Looks in sparse/N, in sparse/ and in the scene folder itself; of several models takes the one with most images.
/// @throws InputError if there is none.
SparseModelFolder find_model_folder(const std::filesystem::path& source);

}  // namespace b3dgs
