// SIMPLE_PINHOLE, PINHOLE (no distortion), SIMPLE_RADIAL and RADIAL.
#pragma once

#include "scene/cameras/models/lens_model.h"

namespace b3dgs {

inline double no_radial_factor(const double*, double) {
  return 1;
}

/// No coefficients.
inline constexpr LensModel kPinholeLens{no_radial_factor, distort_radially<no_radial_factor>, true};

/// N coefficients: the radius becomes r (1 + k1 r^2 + k2 r^4 + ...).
template <std::size_t N>
double radial_factor(const double* k, double r) {
  return polynomial<N>(k, r * r);
}

template <std::size_t N>
inline constexpr LensModel kRadialLens{radial_factor<N>, distort_radially<radial_factor<N>>, true};

}  // namespace b3dgs
