// Inside the reader of transforms.json: values of a frame, or else of the whole file, and the camera of a frame.
#pragma once

#include <functional>
#include <optional>
#include <string>

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
  std::optional<bool> boolean(const char* key) const;
  /// "" if the key is missing.
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
