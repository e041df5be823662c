#include "model/cameras/camera_files.h"

#include <algorithm>
#include <cmath>
#include <fstream>
#include <iterator>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>

#include "core/check.h"
#include "core/json_text.h"
#include "scene/cameras/camera.h"
#include "scene/images/image_io.h"
#include "scene/transforms/transforms.h"

namespace b3dgs {
namespace {

namespace fs = std::filesystem;
using Json = nlohmann::ordered_json;

constexpr double kMaxFps = 1000;
constexpr const char* kExpected = "expected a cameras.json, a nerfstudio camera path or a transforms.json";

/// A finite number in (0, max]. @throws InputError
double positive_number(const Json& json, const char* what, const std::string& place, double max) {
  const double value = json.is_number() ? json.get<double>() : 0;
  if (!(value > 0 && value <= max)) {
    input_error(place, ": expected ", what, " above 0 and at most ", max, ", found ", json_excerpt(json));
  }
  return value;
}

/// A number of pixels; some exporters write 1080.0. @throws InputError
int side(const Json& json, const char* what, const std::string& place) {
  const double value = json.is_number() ? json.get<double>() : 0;
  if (!(value >= 1 && value <= kMaxCameraSide && value == std::floor(value))) {
    input_error(place, ": expected ", what, " as a whole number of pixels from 1 to ", kMaxCameraSide, ", found ",
                json_excerpt(json));
  }
  return static_cast<int>(value);
}

/// 16 numbers, or 3 or 4 rows of 4. @throws InputError
OpenGlMatrix matrix_from_json(const Json& json, const char* what, const std::string& place) {
  OpenGlMatrix matrix{0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 1};
  std::size_t count = 0;
  const auto take = [&](const Json& value) {
    if (count < 16 && value.is_number()) matrix[count] = value.get<double>();
    count = value.is_number() ? count + 1 : 99;
  };
  if (json.is_array()) {
    for (const Json& row : json) {
      if (!row.is_array()) {
        take(row);
      } else if (row.size() == 4) {
        for (const Json& value : row) take(value);
      } else {
        count = 99;
      }
    }
  }
  if (count != 12 && count != 16) {
    input_error(place, ": expected ", what, " of 4 x 4 numbers, found ", json_excerpt(json));
  }
  return matrix;
}

void check_camera(const Camera& camera, const std::string& place) {
  if (const std::string fault = camera_fault(camera); !fault.empty()) input_error(place, ": ", fault);
}

/// The list of frames under `key`. @throws InputError
const Json& frames_of(const Json& json, const char* key, const std::string& file) {
  const Json& frames = json.at(key);
  if (!frames.is_array() || frames.empty()) {
    input_error(file, ": expected at least one frame in \"", key, "\", found ", json_excerpt(frames));
  }
  return frames;
}

// ------------------------------------------------------------------------------------------------ camera path

Camera camera_of_path(const Json& frame, ImageSize size, const std::string& place) {
  if (!frame.is_object() || !frame.contains("camera_to_world") || !frame.contains("fov")) {
    input_error(place, ": expected camera_to_world[16] and fov, found ", json_excerpt(frame));
  }
  const double fov = positive_number(frame["fov"], "fov in degrees", place, 179.9);
  const Camera camera = Camera::with_field_of_view(
      size.width, size.height, fov,
      pose_from_opengl(matrix_from_json(frame["camera_to_world"], "camera_to_world", place), place));
  check_camera(camera, place);
  return camera;
}

CameraFile read_camera_path(const Json& json, const std::string& file, ImageSize size) {
  const std::string type = json.value("camera_type", Json("perspective")).dump();
  if (type != "\"perspective\"") {
    input_error(file, ": camera_type: expected \"perspective\", found ", type.substr(0, 80),
                "; only pinhole cameras can be rendered");
  }
  if (json.contains("render_width") && json.contains("render_height")) {
    size = {side(json["render_width"], "render_width", file), side(json["render_height"], "render_height", file)};
  }
  if (size.width <= 0 || size.height <= 0) {
    input_error(file, ": has no render_width and render_height; name a size with --width and --height");
  }
  CameraFile result;
  for (const Json& frame : frames_of(json, "camera_path", file)) {
    const std::string place = file + ": frame " + std::to_string(result.cameras.size());
    result.cameras.push_back({"", camera_of_path(frame, size, place)});
  }
  if (json.contains("fps")) {
    result.fps = positive_number(json["fps"], "fps", file, kMaxFps);
  } else if (json.contains("seconds")) {
    const double seconds = positive_number(json["seconds"], "seconds", file, 1e6);
    result.fps = std::clamp(static_cast<double>(result.cameras.size()) / seconds, 1e-3, kMaxFps);
  }
  return result;
}

// -------------------------------------------------------------------------------------------- transforms.json

/// Of frames without w and h: the size asked for, or that of the photograph.
CameraFile read_transforms_cameras(const std::string& text, const fs::path& path, ImageSize size) {
  TransformsModel frames;
  const auto size_of = [&](const std::string& name) -> std::optional<ImageSize> {
    if (size.width > 0 && size.height > 0) return size;
    const fs::path& photograph = frames.files.at(name);
    std::error_code error;
    if (fs::is_regular_file(photograph, error)) return read_image_size(photograph);
    input_error(path.string(), ": frame ", frames.model.images.size(), " (", name,
                "): has no size (w, h), and no photograph; name a size with --width and --height");
  };
  read_transforms(text, path, size_of, frames);
  CameraFile result;
  for (const ColmapImage& image : frames.model.images) {
    const ColmapCamera& lens = frames.model.cameras.at(image.camera_id);
    const std::string& place = frames.camera_places.at(image.camera_id);
    Camera camera = lens_of(lens, place).pinhole({static_cast<int>(lens.width), static_cast<int>(lens.height)});
    camera.cam_from_world = {rotation_from_quaternion(image.quat), image.translation};
    check_camera(camera, place);
    result.cameras.push_back({image.name, camera});
  }
  return result;
}

}  // namespace

CameraFile read_camera_file(const fs::path& path, ImageSize size) {
  std::error_code error;
  if (!fs::exists(path, error)) input_error("camera file not found: ", path.string(), " (", kExpected, ")");
  std::ifstream file(path, std::ios::binary);
  if (fs::is_directory(path, error) || !file) {
    input_error(path.string(), ": cannot be read as a file (", kExpected, ")");
  }
  return parse_camera_file({std::istreambuf_iterator<char>(file), std::istreambuf_iterator<char>()}, path, size);
}

CameraFile parse_camera_file(const std::string& text, const fs::path& path, ImageSize size) {
  const Json json = parse_json(text);
  if (json.is_discarded()) input_error(path.string(), ": not valid JSON (", kExpected, ")");
  if (json.is_array()) return {cameras_from_json(json, path.string()), 0};
  if (json.is_object() && json.contains("camera_path")) return read_camera_path(json, path.string(), size);
  if (json.is_object() && json.contains("frames")) return read_transforms_cameras(text, path, size);
  input_error(path.string(),
              ": unknown kind of camera file (expected a list of cameras, \"camera_path\" or \"frames\")",
              json.is_object() && json.contains("keyframes") ? "; it has keyframes only: export the path again" : "");
}

}  // namespace b3dgs
