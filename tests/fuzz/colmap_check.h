// Checks that the values of a COLMAP model, once read, are usable.
#pragma once

#include <cmath>

#include "core/check.h"
#include "core/files/file_reader.h"
#include "scene/cameras/camera_lens.h"
#include "scene/colmap/colmap.h"

namespace b3dgs::fuzz {

inline bool is_finite_float(double value) {
  return std::isfinite(static_cast<float>(value));
}

/// Converts the model to views. @throws InputError for cameras that cannot be used
inline void check_model(const ColmapModel& model) {
  for (const ColmapImage& image : model.images) {
    Camera view = camera_of(model.cameras.at(image.camera_id), "cameras");
    view.cam_from_world.rotation = rotation_from_quaternion(image.quat);
    view.cam_from_world.translation = image.translation;
    const Camera half = view.scaled_to((view.width + 1) / 2, (view.height + 1) / 2);
    const float fx = static_cast<float>(half.fx), fy = static_cast<float>(half.fy);
    B3DGS_CHECK(fx > 0 && fy > 0 && std::isfinite(fx) && std::isfinite(fy), "focal lengths ", fx, " and ", fy);
    B3DGS_CHECK(is_finite_float(half.cx) && is_finite_float(half.cy), "principal point ", half.cx, ", ", half.cy);
    for (const double value : half.center()) B3DGS_CHECK(is_finite_float(value), "camera centre at ", value);
    for (const double value : half.cam_from_world.rotation) B3DGS_CHECK(std::abs(value) < 1.001, "rotation ", value);
    distort(view.lens, 0.5, -0.25);
  }
  for (const ColmapPoint& point : model.points) {
    for (const double value : point.position) B3DGS_CHECK(is_finite_float(value * value), "point at ", value);
  }
}

inline void read_colmap(std::string_view cameras, std::string_view images, std::string_view points,
                        ColmapFormat format) {
  FileReader camera_file("cameras", cameras), image_file("images", images), point_file("points3D", points);
  check_model(read_colmap_model({camera_file, image_file, point_file}, format, Observations::kTracks));
}

}  // namespace b3dgs::fuzz
