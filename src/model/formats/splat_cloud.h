// The stored (pre-activation) parameters of Gaussians in host memory: the contents of a PLY, and what training starts
// from.
#pragma once

#include <cstdint>
#include <vector>

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
  std::vector<float> means;            // [N, 3] world
  std::vector<float> log_scales;       // [N, 3] natural log of world units
  std::vector<float> quats;            // [N, 4] w, x, y, z, any length but 0
  std::vector<float> logit_opacities;  // [N]
  std::vector<float> sh0;              // [N, 3] RGB
  std::vector<float> shN;              // [N, K-1, 3], K = sh_coefficient_count(sh_degree), coefficient-major

  std::int64_t size() const { return static_cast<std::int64_t>(logit_opacities.size()); }
};

}  // namespace b3dgs
