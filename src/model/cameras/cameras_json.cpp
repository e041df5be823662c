#include "model/cameras/cameras_json.h"

#include <cmath>
#include <fstream>

#include "core/check.h"
#include "core/json_text.h"
#include "scene/cameras/coordinate_frame.h"

namespace b3dgs {
namespace {

using Json = nlohmann::ordered_json;

constexpr double kMaxNumber = 1e12;  // px or world units; squares are finite in single precision

Json camera_to_json(std::size_t id, const View& view, const CoordinateFrame& frame) {
  const Camera camera = change_frame(frame, {}, view.camera);
  const std::array<double, 9>& r = camera.cam_from_world.rotation;
  return {{"id", id},
          {"img_name", view.name},
          {"width", camera.width},
          {"height", camera.height},
          {"position", camera.center()},
          {"rotation", {{r[0], r[3], r[6]}, {r[1], r[4], r[7]}, {r[2], r[5], r[8]}}},  // camera to world
          {"fy", camera.fy},
          {"fx", camera.fx},
          {"cx", camera.cx},
          {"cy", camera.cy}};
}

/// @throws nlohmann::json::exception for missing keys and wrong types; InputError for sizes out of range
NamedCamera camera_from_json(const Json& entry, const std::string& place) {
  NamedCamera named;
  named.name = entry.at("img_name").get<std::string>();
  Camera& camera = named.camera;
  camera.width = json_integer<int>(entry.at("width"), "width", place, 1, kMaxCameraSide);
  camera.height = json_integer<int>(entry.at("height"), "height", place, 1, kMaxCameraSide);
  entry.at("fx").get_to(camera.fx);
  entry.at("fy").get_to(camera.fy);
  camera.cx = entry.value("cx", 0.5 * camera.width);
  camera.cy = entry.value("cy", 0.5 * camera.height);
  named.held_out = entry.value("held_out", false);
  const auto position = entry.at("position").get<std::array<double, 3>>();
  const auto world_from_cam = entry.at("rotation").get<std::array<std::array<double, 3>, 3>>();
  Pose& pose = camera.cam_from_world;
  for (std::size_t row = 0; row < 3; ++row) {
    for (std::size_t column = 0; column < 3; ++column) {
      pose.rotation[3 * row + column] = world_from_cam[column][row];
      pose.translation[row] -= world_from_cam[column][row] * position[column];
    }
  }
  return named;
}

}  // namespace

std::string camera_fault(const Camera& camera) {
  if (!(camera.fx > 0) || !(camera.fy > 0)) return "expected focal lengths above 0";
  for (const double value : {camera.fx, camera.fy, 1 / camera.fx, 1 / camera.fy, camera.cx, camera.cy}) {
    if (!(std::abs(value) <= kMaxNumber)) return "impossible focal length or principal point";
  }
  for (const double value : camera.cam_from_world.translation) {
    if (!(std::abs(value) <= kMaxNumber)) return "impossible position, expected coordinates of at most 1e+12";
  }
  const std::array<double, 9>& r = camera.cam_from_world.rotation;
  for (std::size_t row = 0; row < 9; row += 3) {
    const double squared = r[row] * r[row] + r[row + 1] * r[row + 1] + r[row + 2] * r[row + 2];
    if (!(std::abs(squared - 1) < 1e-3)) return "expected an orthonormal rotation matrix";
  }
  return "";
}

nlohmann::ordered_json cameras_to_json(const std::vector<View>& test, const std::vector<View>& train,
                                       const CoordinateFrame& frame) {
  Json cameras = Json::array();
  for (const std::vector<View>* views : {&test, &train}) {
    for (const View& view : *views) {
      cameras.push_back(camera_to_json(cameras.size(), view, frame));
      if (views == &test) cameras.back()["held_out"] = true;
    }
  }
  return cameras;
}

std::vector<NamedCamera> cameras_from_json(const Json& json, const std::string& file) {
  if (!json.is_array() || json.empty()) {
    input_error(file, ": expected a JSON list of cameras, as b3dgs train writes it");
  }
  std::vector<NamedCamera> cameras;
  for (const Json& entry : json) {
    const std::string place = file + ": camera " + std::to_string(cameras.size());
    try {
      cameras.push_back(camera_from_json(entry, place));
    } catch (const Json::exception&) {
      input_error(place, ": expected img_name, width, height, position[3], rotation[3][3], fx and fy");
    }
    if (const std::string fault = camera_fault(cameras.back().camera); !fault.empty()) {
      input_error(place, " (", cameras.back().name, "): ", fault);
    }
  }
  return cameras;
}

std::vector<NamedCamera> read_cameras_json(const std::filesystem::path& path) {
  std::ifstream file(path);
  if (!file) input_error(path.string(), ": cannot be opened (expected the cameras.json of a model folder)");
  return cameras_from_json(parse_json(file), path.string());
}

}  // namespace b3dgs
