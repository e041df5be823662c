// The parameters of the lens of a view. math/lens.h uses them.
#pragma once

#include <cstdint>

#include "core/vec.h"

namespace b3dgs {

enum class LensKind : std::int32_t {
  kPinhole,
  kDistorted,        // perspective lens with radial, tangential and thin-prism distortion
  kFov,              // perspective lenses with their own radial functions
  kDivision,         //
  kEucm,             //
  kFisheye,          // equidistant projection with the same distortion
  kEquirectangular,  // a panorama of 360 x 180 degrees
};

inline constexpr int kLensCoefficients = 11;

/// With s = a^2 + b^2 of the undistorted point (a, b):
///   kDistorted, kFisheye   radial factor (1 + k0 s + k1 s^2 + k2 s^3 + k3 s^4) / (1 + k4 s + k5 s^2 + k6 s^3),
///                          tangential k7 = p1, k8 = p2, thin prism k9 = s1, k10 = s2
///   kFov, kDivision        k0: omega (rad); k
///   kEucm                  k0, k1: alpha, beta
template <class Real>
struct LensParams {
  LensKind kind = LensKind::kPinhole;
  Real k[kLensCoefficients] = {};
  // Largest angle to the axis (rad) at which the lens is evaluated: 1.15 times that of the image's corners, or less if
  // the formula ends before. Gaussians farther out are linearised there, or are not visible. Not used by pinholes and
  // panoramas.
  Real max_angle = 0;
};

// 80 degrees, in rad.
inline constexpr double kMostForDepthAlongAxis = 80 * kDegree;

/// Returns whether depth is the distance from the camera's centre rather than along its axis. This is true where depth
/// along the axis is hardly meaningful: for a panorama, and for a fisheye with a max_angle above 80 degrees. Other
/// fisheyes blend in the order of pinholes, which other programs' viewers also use.
template <class Real>
B3DGS_HD bool has_radial_depth(const LensParams<Real>& lens) {
  return lens.kind == LensKind::kEquirectangular ||
         (lens.kind == LensKind::kFisheye && lens.max_angle > Real(kMostForDepthAlongAxis));
}

using ViewLens = LensParams<float>;

/// Returns how many splats a Gaussian can have. A panorama shows those at its seam twice (math/project_splat.h).
B3DGS_HD int splats_per_gaussian(const ViewLens& lens) {
  return lens.kind == LensKind::kEquirectangular ? 2 : 1;
}

/// Returns the width of a panorama's full turn, px.
template <class Real>
B3DGS_HD Real full_turn(Real fx) {
  return static_cast<Real>(2 * kPi) * fx;
}

}  // namespace b3dgs
