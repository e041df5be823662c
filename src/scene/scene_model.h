// Cameras and points of a scene folder, whichever program wrote them.
#pragma once

#include <cstdint>
#include <filesystem>
#include <map>
#include <set>
#include <string>
#include <vector>

#include "scene/colmap/colmap.h"
#include "scene/images/image_folder.h"
#include "scene/points/point_cloud.h"
#include "scene/scene.h"

namespace b3dgs {

struct SceneModel {
  ColmapModel model;  // without its points
  WorldPoints points;
  std::string description;                             // for the summary: "sparse/0, binary"
  std::string points_description;                      // where points come from, if it is not the model; or ""
  std::vector<std::string> notes;                      // choices made for the user
  std::map<std::uint32_t, std::string> camera_places;  // for errors, by camera ID
  std::map<std::uint32_t, std::vector<std::int32_t>> visible_points;  // with tracks: rows of `points`, by image ID

  /// Files that the scene names itself, by image name. They come before those of the image folder if they exist.
  std::map<std::string, std::filesystem::path> files, masks;

  /// Whether the scene says which views to hold out, and which, by image name. If not, every kTestEvery-th is.
  bool has_split = false;
  std::set<std::string> held_out;
  std::string split_description;  // "transforms_test.json"
};

/// Whether the folder holds a COLMAP model, complete or not, or transforms.json files. Reads nothing.
bool holds_scene(const std::filesystem::path& source);

/// @throws InputError if the folder is missing or holds no scene. Reads nothing
void check_scene_folder(const std::filesystem::path& source);

/// Reads the COLMAP model of the scene, or else its transforms.json files; those of held-out views only if
/// SceneOptions::eval is set. @throws InputError if there is no scene or it cannot be used
SceneModel read_scene_model(const SceneOptions& options, const ImageFolder& images);

}  // namespace b3dgs
