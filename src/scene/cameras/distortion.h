// Lens distortion of COLMAP's camera models, forward: from the ideal ray to where the lens put it.
#pragma once

#include <array>
#include <string>

#include "scene/colmap/colmap.h"

namespace b3dgs {

/// All supported models in one form; coefficients that a model lacks are 0. With r the distance of the undistorted
/// point from the axis on the plane z = 1 and theta = atan(r):
///   perspective: radius r (1 + radial . (r^2, r^4, r^6)) / (1 + denominator . (r^2, r^4, r^6)), then p1, p2
///   tangentially fisheye:     radius theta (1 + radial . (theta^2, theta^4, theta^6, theta^8))
struct Lens {
  double fx = 0, fy = 0, cx = 0, cy = 0;  // px
  bool is_fisheye = false;
  std::array<double, 4> radial{};
  std::array<double, 3> denominator{};  // perspective only
  double p1 = 0, p2 = 0;                // perspective only

  /// A fisheye never is: without coefficients it is the equidistant projection.
  bool is_pinhole() const;
  /// The same lens for an image of another size.
  Lens scaled(double sx, double sy) const;
};

/// @throws InputError, beginning with `place`, for the models FOV and THIN_PRISM_FISHEYE and for focal lengths and
/// principal points that no camera has.
Lens lens_of(const ColmapCamera& camera, const std::string& place);

/// Undistorted to distorted point, both on the plane z = 1.
std::array<double, 2> distort(const Lens& lens, double x, double y);

/// Largest undistorted radius up to `limit` below which the distorted radius grows. Beyond it the polynomial, which was
/// fitted to the image only, folds the plane back into the image.
double monotonic_radius(const Lens& lens, double limit);

}  // namespace b3dgs
