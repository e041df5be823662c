// What density control learns of each Gaussian between two of its rounds.
#pragma once

#include <array>
#include <cstdint>

#include "raster/torch/rasterizer.h"

namespace b3dgs {

struct DensityStatistics {
  torch::Tensor grad_norm_sum;  // [N] float, norms of the gradient by the projected centre, in units of half the image
  torch::Tensor view_count;     // [N] int32, views that saw the Gaussian
  torch::Tensor max_radii;      // [N] int32, px, largest radius in any of them

  static constexpr std::array<const char*, 3> kNames{"grad_norm_sum", "view_count", "max_radii"};
  std::array<torch::Tensor*, 3> all() { return {&grad_norm_sum, &view_count, &max_radii}; }
  std::array<const torch::Tensor*, 3> all() const { return {&grad_norm_sum, &view_count, &max_radii}; }
};

/// Nothing seen yet.
DensityStatistics make_density_statistics(std::int64_t n_gaussians, torch::Device device);

/// Adds one view of width x height px. A gradient in 1/px times half the width (height) is one in normalised device
/// units, as which the threshold of the original is meant.
void add_view(const ViewStatistics& view, std::int32_t width, std::int32_t height, DensityStatistics& statistics);

}  // namespace b3dgs
