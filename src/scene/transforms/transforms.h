// Scenes in transforms.json files, as NeRF's synthetic scenes, instant-ngp, nerfstudio and Polycam write them. Cameras
// and photographs have the structures of the COLMAP reader.
#pragma once

#include <filesystem>
#include <functional>
#include <map>
#include <optional>
#include <set>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "core/check.h"
#include "core/json_text.h"
#include "scene/cameras/camera.h"
#include "scene/colmap/colmap.h"
#include "scene/images/image.h"

namespace b3dgs {

/// A number is NaN or infinite, or a matrix cannot be the pose of a camera.
class UnusableValue : public InputError {
 public:
  using InputError::InputError;
};

/// Values of a JSON object, such as a frame, with another one, such as the whole file, as fallback. Returns nothing,
/// false or "" if neither has the key. @throws InputError, beginning with `place`, for wrong types and impossible
/// values; UnusableValue for numbers that are NaN or infinite
class JsonValues {
 public:
  using Json = nlohmann::ordered_json;
  JsonValues(const Json& object, const Json& other, std::string place)
      : object_(object), other_(other), place_(std::move(place)) {}

  const std::string& place() const { return place_; }
  /// Returns a finite number of at most kMaxCoordinate.
  std::optional<double> number(const char* key) const;
  /// Returns a number above 0 and at most `max`.
  std::optional<double> positive(const char* key, double max) const;
  /// Returns an integer number of pixels, which may be written as 800.0.
  std::optional<int> side(const char* key) const;
  bool boolean(const char* key) const;
  std::string text(const char* key) const;
  /// Reads 16 numbers, or 4 rows of 4. The last row may be missing. @throws InputError also if there is none
  OpenGlMatrix matrix(const char* key) const;

 private:
  const Json* find(const char* key, bool (Json::*is_expected)() const noexcept, const char* expected) const;

  const Json &object_, &other_;
  std::string place_;
};

/// Parses JSON as other programs write it. Comments are ignored, and numbers that are not finite, such as NaN, become
/// strings that JsonValues knows. @throws InputError, beginning with `place`
nlohmann::ordered_json parse_json_with_extras(std::string_view text, const std::string& place);

/// The files of a scene folder.
struct TransformsFiles {
  std::filesystem::path train;     // transforms_train.json or transforms.json; empty: there is none
  std::filesystem::path held_out;  // transforms_test.json, or else transforms_val.json; empty: there is none
  std::vector<std::string> notes;  // which files are not used
};

TransformsFiles find_transforms(const std::filesystem::path& source);

/// Frames of one or several files.
struct TransformsModel {
  /// A camera for each set of intrinsics, in the simplest of COLMAP's models that has its distortion, and an image for
  /// each frame, named after its file_path. ".png" is added if there is no image extension, and "./" and parts that
  /// lead out of the folder are dropped. The camera ID is 0 if the size is unknown. There are no points.
  ColmapModel model;
  std::map<std::uint32_t, std::string> camera_places;  // "FILE: frame N (NAME)", by camera ID, for errors
  std::map<std::string, std::filesystem::path> files;  // by image name: file_path, relative to the file
  std::map<std::string, std::filesystem::path> masks;  // by image name: mask_path, where there is one
  // Image names: train_filenames, test_filenames, val_filenames.
  std::set<std::string> listed_for_training, listed_as_test, listed_as_validation;
  std::filesystem::path points;  // ply_file_path; empty: there is none
};

/// The size of a frame's photograph, in px. Intrinsics in px belong to the photograph that file_path names.
struct PhotographSizes {
  std::optional<ImageSize> named;  // of that photograph; nothing if it is missing
  std::optional<ImageSize>
      used{};  // of the photograph that replaces a missing one, perhaps reduced; nothing: none does
};
using PhotographSizesFn = std::function<PhotographSizes(const std::string& image_name)>;

/// Adds the frames of the text of a file. `sizes_of` is called for frames without w and h. Ignores unknown keys, and
/// takes poses as written, regardless of applied_transform. @throws InputError with file, frame, expected and found,
/// also for camera models that photographs cannot be undistorted from. Leaves out frames with an UnusableValue, unless
/// all have one
void read_transforms(std::string_view text, const std::filesystem::path& file, const PhotographSizesFn& sizes_of,
                     TransformsModel& model);

}  // namespace b3dgs
