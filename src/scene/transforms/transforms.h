// Inside the reader of transforms.json: values of a frame, or else of the whole file, and the camera of a frame.
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

#include "core/json_text.h"
#include "scene/colmap/colmap.h"
#include "scene/images/image.h"

namespace b3dgs::transforms {

using Json = nlohmann::ordered_json;

/// A finite number of at most 10^12. @throws InputError
double finite_number(const Json& json, const std::string& what, const std::string& place);

/// Looks keys up in a frame first, then in the file. @throws InputError, beginning with `place`, for wrong types
class FrameValues {
 public:
  FrameValues(const Json& frame, const Json& file, std::string place)
      : frame_(frame), file_(file), place_(std::move(place)) {}

  const std::string& place() const { return place_; }
  std::optional<double> number(const char* key) const;
  /// 0 if the key is missing.
  double coefficient(const char* key) const { return number(key).value_or(0); }
  /// A whole number of pixels, which may be written as 800.0.
  std::optional<int> side(const char* key) const;
  /// False, or "", if the key is missing.
  bool boolean(const char* key) const;
  std::string text(const char* key) const;

 private:
  const Json* find(const char* key) const;

  const Json &frame_, &file_;
  std::string place_;
};

/// The camera of a frame, with ID 0, in the simplest of COLMAP's models that has its distortion. `size_of_photograph`
/// is asked if there is no w or h; without a size, the result is nothing. @throws InputError for camera models that
/// photographs cannot be undistorted from, and missing or impossible values
std::optional<ColmapCamera> camera_of_frame(const FrameValues& values,
                                            const std::function<std::optional<ImageSize>()>& size_of_photograph);

}  // namespace b3dgs::transforms

namespace b3dgs {

// Scenes in transforms.json files, as NeRF's synthetic scenes, instant-ngp, nerfstudio and Polycam write them: cameras
// and photographs in the structures of the COLMAP reader.

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
