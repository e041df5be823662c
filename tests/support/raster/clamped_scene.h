// A scene of Gaussians whose projection is clamped.
#pragma once

#include "support/raster/test_scenes.h"

namespace b3dgs::test {

/// smooth_scene() with three Gaussians outside the image, where the Jacobian of the projection is clamped.
inline TestScene clamped_scene() {
  TestScene scene = smooth_scene();
  // Far to the left and below, and large enough to be visible all over the image.
  scene.view.rotation = {{1, 0, 0, 0, 1, 0, 0, 0, 1}};
  scene.view.translation = scene.view.center = {0, 0, 0};
  GaussianTensors& g = scene.gaussians;
  g.means = torch::tensor({{-2.4f, 0.1f, 3.0f}, {0.2f, 2.2f, 2.5f}, {2.0f, -1.9f, 2.0f}});
  g.log_scales = torch::tensor({{0.3f, 0.1f, 0.2f}, {0.0f, 0.3f, 0.4f}, {0.2f, 0.5f, 0.1f}});
  for (torch::Tensor* group : {&g.quats, &g.logit_opacities, &g.sh0, &g.shN}) *group = group->slice(0, 0, 3).clone();
  return scene;
}

}  // namespace b3dgs::test
