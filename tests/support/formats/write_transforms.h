// Writes a COLMAP model as a transforms.json, as nerfstudio's converter does.
#pragma once

#include <nlohmann/json.hpp>
#include <string>

#include "scene/cameras/camera.h"
#include "scene/colmap/colmap.h"
#include "support/files.h"

namespace b3dgs::test {

using Json = nlohmann::ordered_json;

/// Returns the rows of the camera-to-world matrix.
inline Json transform_matrix(const Pose& pose) {
  const OpenGlMatrix m = opengl_from_pose(pose);
  Json rows = Json::array();
  for (std::size_t row = 0; row < 4; ++row)
    rows.push_back({m[4 * row], m[4 * row + 1], m[4 * row + 2], m[4 * row + 3]});
  return rows;
}

/// Returns w, h, fl_x, ... of a camera with the model PINHOLE, OPENCV, OPENCV_FISHEYE, SIMPLE_RADIAL or RADIAL.
inline Json intrinsics(const ColmapCamera& camera) {
  Json json{{"camera_model", camera_model_name(camera.model)}, {"w", camera.width}, {"h", camera.height}};
  std::string params = camera_model_params(camera.model);
  std::size_t begin = 0;
  for (const double value : camera.params) {
    const std::size_t end = std::min(params.find(", ", begin), params.size());
    const std::string name = params.substr(begin, end - begin);
    begin = end + 2;
    if (name == "f" || name == "fx") json["fl_x"] = value;
    if (name == "f" || name == "fy") json["fl_y"] = value;
    if (name == "k") json["k1"] = value;
    if (name != "f" && name != "fx" && name != "fy" && name != "k") json[name] = value;
  }
  return json;
}

/// Returns frames with their own intrinsics. File paths are "images/NAME".
inline Json transforms_of(const ColmapModel& model) {
  Json json{{"frames", Json::array()}};
  for (const ColmapImage& image : model.images) {
    Json frame = intrinsics(model.cameras.at(image.camera_id));
    frame["file_path"] = "images/" + image.name;
    frame["transform_matrix"] = transform_matrix({rotation_from_quaternion(image.quat), image.translation});
    json["frames"].push_back(frame);
  }
  return json;
}

}  // namespace b3dgs::test
