// A scene that trains in seconds: Gaussians in a ball, cameras around them, images rendered from the Gaussians, and
// points that are noisy samples of them.
#pragma once

#include <cmath>
#include <memory>

#include "core/random.h"
#include "core/vec.h"
#include "scene/scene.h"
#include "scene/view_image.h"
#include "train/evaluate.h"
#include "train/gaussians/gaussian_model.h"
#include "train/quality/metrics.h"

namespace b3dgs::test {

/// Makes a camera at `center` that looks at the origin, +y down.
inline Camera look_at_origin(double x, double y, double z, int width, int height) {
  const double length = std::sqrt(x * x + y * y + z * z);
  const double f[3] = {-x / length, -y / length, -z / length};  // forward
  const double side = std::sqrt(f[0] * f[0] + f[2] * f[2]);
  const double r[3] = {f[2] / side, 0, -f[0] / side};  // right = (0, 1, 0) x forward
  const double d[3] = {f[1] * r[2] - f[2] * r[1], f[2] * r[0] - f[0] * r[2], f[0] * r[1] - f[1] * r[0]};
  Camera camera;
  camera.width = width;
  camera.height = height;
  camera.fx = camera.fy = 1.1 * width;
  camera.cx = 0.5 * width;
  camera.cy = 0.5 * height;
  camera.cam_from_world.rotation = {r[0], r[1], r[2], d[0], d[1], d[2], f[0], f[1], f[2]};
  for (int row = 0; row < 3; ++row) {
    const double* axis = row == 0 ? r : row == 1 ? d : f;
    camera.cam_from_world.translation[row] = -(axis[0] * x + axis[1] * y + axis[2] * z);
  }
  return camera;
}

struct TinySceneOptions {
  int n_gaussians = 120;
  int n_views = 8;
  int width = 60, height = 44;  // px
  float log_scale = -2.2f;      // mean of the Gaussians' log scales
  bool masked = false;          // the left fifth of every image is wrong and marked invalid
};

/// Makes few Gaussians in many views, which a short training learns well.
inline TinySceneOptions learnable_scene() {
  TinySceneOptions options;
  options.n_gaussians = 60;
  options.n_views = 24;
  return options;
}

/// `truth_out` (may be null) receives the Gaussians that the images show.
inline Scene make_tiny_scene(const TinySceneOptions& options = {}, GaussianTensors* truth_out = nullptr) {
  const RandomKey key{11, RandomStream::kSplit, 0};
  SplatCloud truth;
  PointCloud points;
  for (int i = 0; i < options.n_gaussians; ++i) {
    const auto place = random_normal(key, 3 * i), shape = random_normal(key, 3 * i + 1);
    const auto color = random_uniform(key, 3 * i + 2);
    for (int axis = 0; axis < 3; ++axis) {
      truth.means.push_back(0.45f * place[axis]);
      truth.log_scales.push_back(options.log_scale + 0.3f * shape[axis]);
      points.positions.push_back(truth.means.back() + 0.03f * shape[(axis + 1) % 3]);
      points.colors.push_back(static_cast<std::uint8_t>(255 * color[axis]));
      truth.sh0.push_back((color[axis] - 0.5f) / 0.2820948f);
    }
    for (const float q : {1.0f, 0.5f * shape[0], 0.5f * shape[1], 0.5f * shape[2]}) truth.quats.push_back(q);
    truth.logit_opacities.push_back(2.0f + shape[3]);
  }
  Scene scene;
  scene.source_path = "tiny";
  scene.points = points;
  const GaussianTensors gaussians = to_tensors(truth, 0, torch::kCPU);
  if (truth_out != nullptr) *truth_out = gaussians;
  Rasterizer rasterizer(torch::kCPU);
  for (int i = 0; i < options.n_views; ++i) {
    const double angle = (2 * kPi) * i / options.n_views;
    View view;
    view.name = "view" + std::to_string(i) + ".png";
    view.camera = look_at_origin(3 * std::cos(angle), i % 2 == 0 ? -1.0 : 0.7, 3 * std::sin(angle), options.width,
                                 options.height);
    const RenderedView rendered = rasterizer.forward(gaussians, to_camera_view(view.camera), {});
    Image8 image = to_image8(rendered.color);
    if (options.masked) {
      auto valid = std::make_shared<Image8>(options.width, options.height, 1);
      for (int p = 0; p < options.width * options.height; ++p) {
        const bool is_valid = p % options.width >= options.width / 5;
        valid->pixels[p] = is_valid ? 255 : 0;
        for (int c = 0; c < 3 && !is_valid; ++c) image.pixels[3 * p + c] = 255;
      }
      view.valid = valid;
    }
    view.image = std::make_shared<ViewImage>(std::move(image));
    (i % 4 == 0 ? scene.test : scene.train).push_back(view);
  }
  scene.extent = scene_extent(scene.train);
  return scene;
}

}  // namespace b3dgs::test

namespace b3dgs {

inline Evaluation evaluate_views(Rasterizer& rasterizer, const GaussianTensors& gaussians,
                                 const std::vector<View>& views, const RenderSettings& settings,
                                 const RenderedFn& on_rendered = {}, const LpipsNetwork* lpips = nullptr,
                                 const ColorEvaluation& colors = {}) {
  const RenderFn render = [&](const CameraView& view) { return rasterizer.forward(gaussians, view, settings); };
  return evaluate_views(render, gaussians.means.device(), views, on_rendered, lpips, colors);
}

}  // namespace b3dgs
