// SIMPLE_RADIAL_FISHEYE, RADIAL_FISHEYE and OPENCV_FISHEYE: the equidistant projection with radial distortion.
// SIMPLE_FISHEYE and FISHEYE: without.
#pragma once

#include "scene/cameras/models/lens_model.h"

namespace b3dgs {

/// N coefficients: with theta = atan(r) the radius becomes theta (1 + k1 theta^2 + k2 theta^4 + ...).
template <std::size_t N>
double fisheye_radial_factor(const double* k, double r) {
  const double theta = std::atan(r);
  return (r > 1e-12 ? theta / r : 1.0) * polynomial<N>(k, theta * theta);
}

template <std::size_t N>
inline constexpr LensModel kFisheyeLens{fisheye_radial_factor<N>, distort_radially<fisheye_radial_factor<N>>, false};

}  // namespace b3dgs
