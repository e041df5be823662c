// The parts of load_scene(): cameras and points of a scene folder from any program; points found in the photographs;
// the description of a scene.
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

struct ViewSource;

struct SceneModel {
  ColmapModel model;  // without its points
  WorldPoints points;
  std::string file;                                    // names the images, for errors
  std::string description;                             // for the summary: "sparse/0, binary"
  std::string points_description;                      // source of the points, if it is not the model; or ""
  std::vector<std::string> notes;                      // choices made for the user
  std::map<std::uint32_t, std::string> camera_places;  // for errors, by camera ID
  std::map<std::uint32_t, std::vector<std::int32_t>> visible_points;  // with tracks: indices of `points`, by image ID

  /// Files that the scene itself names, by image name. If they exist, they take precedence over the image folder.
  std::map<std::string, std::filesystem::path> files, masks;

  /// The file that names the views to hold out ("transforms_test.json"), and their image names. "": every
  /// kTestEvery-th.
  std::string split;
  std::set<std::string> held_out;
  std::vector<std::string> warnings;
};

/// Returns whether the folder contains a COLMAP model, complete or not, or transforms.json files. Reads nothing.
bool holds_scene(const std::filesystem::path& source);

/// Reads the COLMAP model of the scene, or else its transforms.json files. Those of held-out views are read only if
/// SceneOptions::eval is set. @throws InputError if there is no scene or it cannot be used
SceneModel read_scene_model(const SceneOptions& options, const ImageFolder& images);

/// Adds points that seed_points() finds in at most 120 training photographs, in the frame of the scene. A scene without
/// points gets about 50,000 (two for each pixel of smaller photographs). If a scene has points, and more than a tenth
/// of the image area shows none of them, it gets at most that fraction of this number there, only at pixels of clear
/// depth. Returns the number of added points. The scene's frame must be that of choose_frame() for its cameras and
/// points.
std::int64_t add_points_of_photographs(Scene& scene, const ProgressFn& progress);

/// Intermediate results of load_scene() that are not part of the scene.
struct SceneOrigin {
  const SceneOptions& options;
  const SceneModel& model;
  const ImageFolder& image_folder;
  const std::vector<ViewSource>& sources;  // photographs that are on disk, sorted by name
  std::vector<std::string> missing;        // registered names without a file
  std::size_t n_unregistered = 0;          // image files that the model does not name
};

/// Returns about a dozen lines that describe the scene to the user.
std::vector<std::string> summarize(const Scene& scene, const SceneOrigin& origin);

}  // namespace b3dgs
