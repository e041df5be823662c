// THIN_PRISM_FISHEYE: the equidistant projection with radial, tangential and thin-prism distortion, as the ETH3D
// benchmark defines it (Weng et al. 1992 for the thin prism).
#pragma once

#include "scene/cameras/models/fisheye.h"

namespace b3dgs {

/// k = k1, k2, p1, p2, k3, k4, sx1, sy1: theta = atan(r) becomes theta (1 + k1 theta^2 + k2 theta^4 + ...).
inline double thin_prism_radial_factor(const double* k, double r) {
  const double radial[4] = {k[0], k[1], k[4], k[5]};
  return fisheye_radial_factor<4>(radial, r);
}

/// Tangential and thin-prism distortion act on the point of the equidistant projection, at distance theta.
inline std::array<double, 2> distort_thin_prism(const double* k, double x, double y) {
  const double p1 = k[2], p2 = k[3], sx1 = k[6], sy1 = k[7];
  const double r = std::sqrt(x * x + y * y), theta = std::atan(r);
  const double factor = thin_prism_radial_factor(k, r), to_theta = r > 1e-12 ? theta / r : 1.0;
  const double u = x * to_theta, v = y * to_theta, theta2 = theta * theta;
  return {x * factor + 2 * p1 * u * v + p2 * (theta2 + 2 * u * u) + sx1 * theta2,
          y * factor + 2 * p2 * u * v + p1 * (theta2 + 2 * v * v) + sy1 * theta2};
}

inline constexpr LensModel kThinPrismFisheyeLens{thin_prism_radial_factor, distort_thin_prism, false};

}  // namespace b3dgs
