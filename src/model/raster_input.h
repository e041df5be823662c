// Conversion of a scene's camera and of Gaussians to the input of the rasterizer.
#pragma once

#include <algorithm>
#include <iterator>

#include "model/formats/splat_formats.h"
#include "raster/args.h"
#include "scene/cameras/camera.h"

namespace b3dgs {

/// Returns the camera in single precision, with its centre.
inline CameraView to_camera_view(const Camera& camera) {
  CameraView view{};
  for (std::size_t i = 0; i < 9; ++i) view.rotation.m[i] = static_cast<float>(camera.cam_from_world.rotation[i]);
  const auto to_float = [](const std::array<double, 3>& v) {
    return Vec3f{static_cast<float>(v[0]), static_cast<float>(v[1]), static_cast<float>(v[2])};
  };
  view.translation = to_float(camera.cam_from_world.translation);
  view.center = to_float(camera.center());
  view.fx = static_cast<float>(camera.fx);
  view.fy = static_cast<float>(camera.fy);
  view.cx = static_cast<float>(camera.cx);
  view.cy = static_cast<float>(camera.cy);
  view.width = camera.width;
  view.height = camera.height;
  view.lens.kind = camera.lens.kind;
  std::copy(std::begin(camera.lens.k), std::end(camera.lens.k), view.lens.k);
  view.lens.max_angle = static_cast<float>(camera.lens.max_angle);
  return view;
}

/// Returns pointers into `cloud`, which has to outlive them.
inline GaussianArrays to_gaussian_arrays(const SplatCloud& cloud) {
  return {cloud.size(),       cloud.sh_degree,
          cloud.means.data(), cloud.log_scales.data(),
          cloud.quats.data(), cloud.logit_opacities.data(),
          cloud.sh0.data(),   cloud.shN.data()};
}

}  // namespace b3dgs
