// Depth as numbers, for `b3dgs render --depth_format png16|exr`.
#pragma once

#include <torch/types.h>

#include <cstdint>
#include <filesystem>
#include <vector>

#include "scene/images/image.h"

namespace b3dgs {

/// Pixels less opaque than this have no depth.
inline constexpr float kLeastDepthAlpha = 0.5f / 255;

/// Mean depth along the camera's z axis of what a pixel shows, weighted by its blend weights: [H, W] world units; 0
/// where nothing is seen. `depth` [H, W]: sum of weight x depth. `alpha` [H, W]: sum of the weights.
std::vector<float> mean_depths(const torch::Tensor& depth, const torch::Tensor& alpha);

/// Inverse depth in 16 bits, as `train --depths` reads it: value = scale / depth, where `scale` = 65535 x the least
/// depth that can be represented. Nearer pixels get 65535, pixels without a depth 0.
struct InverseDepth16 {
  Depth16 map;
  std::int64_t n_too_near = 0;  // pixels
};
InverseDepth16 inverse_depth_16(const std::vector<float>& depths, ImageSize size, double scale);

/// depth.json, which says how to read the maps of a folder. @throws IoError
void write_depth_scale(const std::filesystem::path& folder, double scale);

}  // namespace b3dgs
