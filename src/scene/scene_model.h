// The parts of load_scene(): cameras and points of a scene folder, whichever program wrote them; points found in the
// photographs; the description of a scene.
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
  std::string file;                                    // that names the images, for errors
  std::string description;                             // for the summary: "sparse/0, binary"
  std::string points_description;                      // where points come from, if it is not the model; or ""
  std::vector<std::string> notes;                      // choices made for the user
  std::map<std::uint32_t, std::string> camera_places;  // for errors, by camera ID
  std::map<std::uint32_t, std::vector<std::int32_t>> visible_points;  // with tracks: rows of `points`, by image ID

  /// Files that the scene names itself, by image name. They come before those of the image folder if they exist.
  std::map<std::string, std::filesystem::path> files, masks;

  /// Where the scene says which views to hold out ("transforms_test.json"), and which, by image name. "": every
  /// kTestEvery-th is.
  std::string split;
  std::set<std::string> held_out;
  std::vector<std::string> warnings;
};

/// Whether the folder holds a COLMAP model, complete or not, or transforms.json files. Reads nothing.
bool holds_scene(const std::filesystem::path& source);

/// Reads the COLMAP model of the scene, or else its transforms.json files; those of held-out views only if
/// SceneOptions::eval is set. @throws InputError if there is no scene or it cannot be used
SceneModel read_scene_model(const SceneOptions& options, const ImageFolder& images);

/// Adds points that seed_points() finds in at most 120 training photographs, in the frame of the scene: about 50,000
/// (two for each pixel of smaller photographs) if the scene has none; if it has some, and more than a tenth of the
/// image area shows none of them, at most that fraction of this number there, only at pixels of clear depth. Returns
/// how many. The scene's frame must be that of choose_frame() for its cameras and points.
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

/// About a dozen lines that describe the scene to the user.
std::vector<std::string> summarize(const Scene& scene, const SceneOrigin& origin);

}  // namespace b3dgs
