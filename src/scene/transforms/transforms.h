// Scenes in transforms.json files, as NeRF's synthetic scenes, instant-ngp, nerfstudio and Polycam write them: cameras
// and photographs in the structures of the COLMAP reader.
#pragma once

#include <array>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <map>
#include <optional>
#include <set>
#include <string>
#include <string_view>
#include <vector>

#include "scene/colmap/colmap.h"
#include "scene/images/image.h"

namespace b3dgs {

/// The files of a scene folder.
struct TransformsFiles {
  std::filesystem::path train;     // transforms_train.json or transforms.json; empty: there is none
  std::filesystem::path held_out;  // transforms_test.json, or else transforms_val.json; empty: there is none
  std::vector<std::string> notes;  // which files are not used

  bool found() const { return !train.empty(); }
};

TransformsFiles find_transforms(const std::filesystem::path& source);

/// Frames of one file or several.
struct TransformsModel {
  /// A camera for each set of intrinsics, of a model of COLMAP; an image for each frame, named after its file_path:
  /// ".png" is added if there is no extension of an image, "./" and what leads out of the folder is dropped. No points.
  ColmapModel model;
  std::map<std::uint32_t, std::string> camera_places;          // "FILE: frame N (NAME)", by camera ID, for errors
  std::map<std::string, std::filesystem::path> files;          // by image name: file_path, relative to the file
  std::map<std::string, std::filesystem::path> masks;          // by image name: mask_path, where there is one
  std::set<std::string> listed_as_test, listed_as_validation;  // image names: test_filenames, val_filenames
  std::filesystem::path points;                                // ply_file_path; empty: there is none
};

/// Size of a photograph by image name, in px; nothing: it is missing.
using PhotographSizeFn = std::function<std::optional<ImageSize>(const std::string& name)>;

/// Adds the frames of a file. `size_of` is asked for frames without w and h. Keys that are not known are ignored; poses
/// are taken as written, whatever applied_transform says. @throws InputError with file, frame, expected and found
void read_transforms(const std::filesystem::path& file, const PhotographSizeFn& size_of, TransformsModel& model);
/// The same for the text of a file.
void read_transforms(std::string_view text, const std::filesystem::path& file, const PhotographSizeFn& size_of,
                     TransformsModel& model);

}  // namespace b3dgs
