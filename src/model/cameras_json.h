// cameras.json of a model folder: the original's list of cameras, which viewers read too.
#pragma once

#include <filesystem>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "scene/scene.h"

namespace b3dgs {

struct NamedCamera {
  std::string name;  // of its image
  Camera camera;
};

/// The original's keys, test views first, and the principal point (cx, cy, px), which the original takes to be the
/// image's centre.
nlohmann::ordered_json cameras_to_json(const Scene& scene);

/// Cameras in the order of the file, ours or the original's. @throws InputError if the file is missing or wrong
std::vector<NamedCamera> read_cameras_json(const std::filesystem::path& path);

}  // namespace b3dgs
