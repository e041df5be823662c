// Scenes in the lens of their photographs: a fisheye of 200 degrees, and a panorama whose seam is among the Gaussians.
#pragma once

#include <gtest/gtest.h>

#include "model/raster_input.h"
#include "scene/cameras/camera_lens.h"
#include "support/temp_dir.h"
#include "support/train/tiny_scene.h"
#include "support/train/training.h"

namespace b3dgs::test {

/// Makes the tiny scene seen by another camera from the same directions, but nearer. Panoramas look away from the
/// Gaussians, so that the seam is among them. `truth_out` (may be null) receives the Gaussians.
inline Scene lens_scene(const Camera& lens, GaussianTensors* truth_out = nullptr) {
  TinySceneOptions options;
  options.log_scale = -2.6f;
  GaussianTensors truth;
  Scene scene = make_tiny_scene(options, &truth);
  Rasterizer rasterizer(torch::kCPU);
  for (std::vector<View>* views : {&scene.train, &scene.test}) {
    for (View& view : *views) {
      Camera camera = native_camera(lens, "");
      camera.cam_from_world = view.camera.cam_from_world;
      Pose& pose = camera.cam_from_world;
      for (double& value : pose.translation) value *= 0.5;
      if (camera.lens.kind == LensKind::kEquirectangular) {
        for (const std::size_t axis : {0, 2}) {  // half a turn about y
          pose.translation[axis] *= -1;
          for (std::size_t column = 0; column < 3; ++column) pose.rotation[3 * axis + column] *= -1;
        }
      }
      view.camera = camera;
      view.image = std::make_shared<ViewImage>(to_image8(rasterizer.forward(truth, to_camera_view(camera), {}).color));
      view.valid = lens_mask(camera);
    }
  }
  if (truth_out != nullptr) *truth_out = truth;
  scene.test = scene.train;  // measures how well the views are learned, not interpolation between them
  return scene;
}

inline Camera wide_fisheye() {
  return {48, 48, 14, 14, 24, 24, {}, {LensKind::kFisheye, {0.02, -0.004, 0.0005, -0.00002}, 0}};
}

inline TrainConfig lens_config() {
  TrainConfig config;
  config.iterations = 200;
  config.device = "cpu";
  config.kernel = "sub-tile";
  config.densify_from_iter = 1000;  // no densification
  config.test_iterations = {1, 200};
  return config;
}

inline Scene fisheye_scene() {
  return lens_scene(wide_fisheye());
}

inline Scene panorama_scene(GaussianTensors* truth_out = nullptr) {
  return lens_scene(panorama_camera({80, 40}), truth_out);
}

inline void expect_improvement(const Scene& scene, const TrainConfig& config) {
  const TempDir temp;
  const Trained run = train(config, scene, temp / "model");
  ASSERT_EQ(run.result.evaluations.size(), 2u);
  EXPECT_GT(run.result.evaluations.back().second.mean.psnr, run.result.evaluations.front().second.mean.psnr + 1.5);
}

}  // namespace b3dgs::test
