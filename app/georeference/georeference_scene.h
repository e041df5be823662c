// Puts a COLMAP scene in metres and upright, by the GPS positions of its photographs.
#pragma once

#include <filesystem>
#include <functional>
#include <optional>
#include <string>

#include "scene/georeference.h"

namespace b3dgs {

struct GeoreferenceOutcome {
  std::optional<Georeference> georeference;  // nothing: the scene is as before
  std::string why_not;                       // one line; empty also if no photograph has a GPS position
  std::filesystem::path previous;            // the earlier model, if the program had not written it
};

/// Transforms the COLMAP model in the folder `model`, so that its coordinates are metres east, north and up. The origin
/// is amid the photographs, at the median height of the points. Writes SCENE/georeference.json. `photograph` returns
/// the file of an image of the model. 2D points and tracks are kept, rigs and frames are not. If the program
/// has not written the earlier model, it is moved to SCENE/sparse.previous. The scene folder must be locked
/// (FolderLock).
/// @throws InputError if the model cannot be read; IoError
GeoreferenceOutcome georeference_scene(const std::filesystem::path& scene, const std::filesystem::path& model,
                                       const std::function<std::filesystem::path(const std::string& name)>& photograph);

}  // namespace b3dgs
