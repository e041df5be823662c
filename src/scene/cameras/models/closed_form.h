// FOV, SIMPLE_DIVISION, DIVISION and EUCM: models of one or two coefficients with a closed form.
#pragma once

#include "scene/cameras/models/lens_model.h"

namespace b3dgs {

/// k = omega, the lens's field of view (radians): r becomes atan(2 r tan(omega / 2)) / omega (Devernay and Faugeras
/// 2001, "Straight lines have to be straight").
inline double fov_radial_factor(const double* k, double r) {
  const double omega = k[0];
  if (omega == 0) return 1;
  const double slope = 2 * std::tan(omega / 2);
  return (r > 1e-12 ? std::atan(r * slope) / r : slope) / omega;
}

/// The division model (Fitzgibbon 2001), k = k: the distorted radius s satisfies r = s / (1 + k s^2). Like radial
/// distortion with the same k to first order. Not a number where no s does, for k > 0.
inline double division_radial_factor(const double* k, double r) {
  return 2 / (1 + std::sqrt(1 - 4 * k[0] * r * r));
}

/// The enhanced unified camera model (Khomutenko et al. 2016), k = alpha, beta: r becomes
/// r / (alpha sqrt(beta r^2 + 1) + 1 - alpha).
inline double eucm_radial_factor(const double* k, double r) {
  const double alpha = k[0], beta = k[1];
  return 1 / (alpha * std::sqrt(beta * r * r + 1) + 1 - alpha);
}

inline constexpr LensModel kFovLens{fov_radial_factor, distort_radially<fov_radial_factor>, true};
inline constexpr LensModel kDivisionLens{division_radial_factor, distort_radially<division_radial_factor>, true};
inline constexpr LensModel kEucmLens{eucm_radial_factor, distort_radially<eucm_radial_factor>, true};

}  // namespace b3dgs
