// Depth and normal images. For people, depth images, show inverse depth, which preserves contrast at close range, in
// the turbo colour map, near red and far blue, fading to black with decreasing alpha. For programs: `b3dgs render
// --depth_format png16|exr`.
#pragma once

#include <torch/types.h>

#include <cstdint>
#include <filesystem>
#include <opencv2/core/mat.hpp>
#include <vector>

#include "model/formats/splat_formats.h"
#include "scene/cameras/camera.h"
#include "scene/images/image.h"

namespace b3dgs {

/// Returns 8-bit grey values in the colours of an OpenCV map (cv::COLORMAP_TURBO).
Image8 colored(const cv::Mat& grey, int map);

/// A range of depths in world units.
struct DepthRange {
  double near = 0, far = 0;
};

/// Returns the 2nd to 98th percentile of the depths of the Gaussians that the cameras see. It is one range for all
/// frames of a path, so that videos do not flicker.
DepthRange visible_depth_range(const SplatCloud& splats, const std::vector<Camera>& cameras, double near_plane);

/// Returns the 2nd to 98th percentile of the depths of a rendered view, over its opaque pixels.
DepthRange depth_range(const torch::Tensor& depth, const torch::Tensor& alpha);

/// Colours rendered depth. `depth` [H, W]: the sum of weight x depth in world units. `alpha` [H, W]: the sum of the
/// weights.
Image8 color_depth(const torch::Tensor& depth, const torch::Tensor& alpha, const DepthRange& range);

/// Colours normals. `normal` [H, W, 3]: unit vectors of the camera frame, or 0 where there is no surface, which is
/// black. Red is right, green is up and blue is towards the camera, as in normal maps: -1 is 0 and 1 is 255.
Image8 color_normals(const torch::Tensor& normal);

/// Pixels less opaque than this have no depth.
inline constexpr float kLeastDepthAlpha = 0.5f / 255;

/// Returns the mean depth along the camera's z axis at each pixel, weighted by its blend weights: [H, W] world units, 0
/// for empty pixels. `depth` [H, W]: sum of weight x depth. `alpha` [H, W]: sum of the weights.
std::vector<float> mean_depths(const torch::Tensor& depth, const torch::Tensor& alpha);

/// Inverse depth in 16 bits, as read by `train --depths`: value = scale / depth, where `scale` = 65535 x the smallest
/// depth that can be represented. Nearer pixels get 65535, pixels without a depth 0.
struct InverseDepth16 {
  Depth16 map;
  std::int64_t n_too_near = 0;  // pixels
};
InverseDepth16 inverse_depth_16(const std::vector<float>& depths, ImageSize size, double scale);

/// Writes depth.json, which is needed to interpret the maps of a folder. @throws IoError
void write_depth_scale(const std::filesystem::path& folder, double scale);

}  // namespace b3dgs
