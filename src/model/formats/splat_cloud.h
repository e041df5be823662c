// The stored (pre-activation) parameters of Gaussians in host memory: the contents of a PLY, in a frame of their own,
// and what training starts from.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "scene/cameras/coordinate_frame.h"

namespace b3dgs {

/// Number of SH coefficients per channel for a degree: 1, 4, 9, 16.
constexpr int sh_coefficient_count(int degree) {
  return (degree + 1) * (degree + 1);
}

struct SplatCloud {
  int sh_degree = 0;  // 0-3
  // Trained with anti-aliasing: scales and opacities include the 3D filter, and a renderer has to apply the 2D filter
  // (RenderSettings::antialiasing).
  bool antialiased = false;
  CoordinateFrame frame;               // of means and scales
  std::vector<float> means;            // [N, 3]
  std::vector<float> log_scales;       // [N, 3] natural log
  std::vector<float> quats;            // [N, 4] w, x, y, z, any length but 0
  std::vector<float> logit_opacities;  // [N]
  std::vector<float> sh0;              // [N, 3] RGB
  std::vector<float> shN;              // [N, K-1, 3], K = sh_coefficient_count(sh_degree), coefficient-major

  std::int64_t size() const { return static_cast<std::int64_t>(logit_opacities.size()); }
};

/// World coordinates of the centres of every k-th Gaussian, fewer than twice `at_most`: [N, 3].
std::vector<double> world_positions(const SplatCloud& cloud, std::size_t at_most = static_cast<std::size_t>(-1));

/// Expresses the same Gaussians in another frame.
void change_frame(const CoordinateFrame& to, SplatCloud& cloud);

}  // namespace b3dgs
