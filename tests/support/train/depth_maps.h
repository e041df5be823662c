// Inverse depth maps of a scene with known Gaussians, on disk, and points that its views see.
#pragma once

#include <cmath>
#include <cstdint>
#include <filesystem>
#include <opencv2/imgcodecs.hpp>
#include <vector>

#include "raster/torch/rasterizer.h"
#include "support/train/tiny_scene.h"

namespace b3dgs::test {

/// Returns the sum of w / z [H, W] that a camera sees of Gaussians.
inline torch::Tensor inverse_depth(const GaussianTensors& gaussians, const Camera& camera) {
  Rasterizer rasterizer(torch::kCPU);
  RenderSettings settings;
  settings.inverse_depth = true;
  return rasterizer.forward(gaussians, to_camera_view(camera), settings).depth;
}

inline void write_depth_png(const std::filesystem::path& path, int width, int height,
                            const std::vector<std::uint16_t>& values) {
  std::filesystem::create_directories(path.parent_path());
  const cv::Mat map(height, width, CV_16UC1, const_cast<std::uint16_t*>(values.data()));
  ASSERT_TRUE(cv::imwrite(path.string(), map));
}

/// Writes the inverse depth d of every training view to FOLDER/VIEW.png as (d - offset) / scale, and adds points to the
/// scene where the view sees a surface.
inline void add_depth_maps(Scene& scene, const GaussianTensors& truth, const std::filesystem::path& folder,
                           double scale, double offset) {
  constexpr std::int64_t kStep = 5;       // px between points
  constexpr double kLeastInverse = 0.15;  // 1 / world units; pixels with less are hardly covered by Gaussians
  for (View& view : scene.train) {
    const Camera& camera = view.camera;
    const torch::Tensor map = inverse_depth(truth, camera).contiguous();
    std::vector<std::uint16_t> values;
    for (std::int64_t p = 0; p < map.numel(); ++p) {
      const double own = map.data_ptr<float>()[p];
      values.push_back(static_cast<std::uint16_t>(std::lround((own - offset) / scale)));
      const std::int64_t column = p % camera.width, row = p / camera.width;
      if (column % kStep != 0 || row % kStep != 0 || own < kLeastInverse) continue;
      const double at[3] = {(static_cast<double>(column) + 0.5 - camera.cx) / camera.fx / own,
                            (static_cast<double>(row) + 0.5 - camera.cy) / camera.fy / own, 1 / own};
      view.points.push_back(static_cast<std::int32_t>(scene.points.size()));
      for (std::size_t axis = 0; axis < 3; ++axis) {
        double value = 0;
        for (std::size_t i = 0; i < 3; ++i) {
          value += camera.cam_from_world.rotation[3 * i + axis] * (at[i] - camera.cam_from_world.translation[i]);
        }
        scene.points.positions.push_back(static_cast<float>(value));
        scene.points.colors.push_back(128);
      }
    }
    write_depth_png(folder / std::filesystem::path(view.name).replace_extension(".png"), camera.width, camera.height,
                    values);
  }
}

}  // namespace b3dgs::test
