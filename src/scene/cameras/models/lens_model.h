// What a kind of lens is: the functions that distort a point, given the coefficients of one camera.
#pragma once

#include <array>
#include <cmath>
#include <cstddef>

namespace b3dgs {

/// Points (x, y) lie on the plane z = 1 in front of the camera, r is their distance from the axis, and `k` points to
/// the camera's coefficients: COLMAP's parameters of the model after focal lengths and principal point.
struct LensModel {
  /// Radial part of the distortion: the distorted radius divided by r.
  double (*radial_factor)(const double* k, double r);
  /// All of the distortion: from the undistorted point to the distorted one.
  std::array<double, 2> (*distort)(const double* k, double x, double y);
  /// Whether a camera whose coefficients are all 0 is a pinhole. A fisheye is not: it is the equidistant projection.
  bool is_pinhole_at_zero;
};

/// 1 + c[0] s + c[1] s^2 + ... + c[N - 1] s^N
template <std::size_t N>
double polynomial(const double* c, double s) {
  double sum = 0;
  for (std::size_t i = N; i-- > 0;) sum = (sum + c[i]) * s;
  return 1 + sum;
}

/// LensModel::distort of a lens that has radial distortion only.
template <double (*radial_factor)(const double*, double)>
std::array<double, 2> distort_radially(const double* k, double x, double y) {
  const double factor = radial_factor(k, std::sqrt(x * x + y * y));
  return {x * factor, y * factor};
}

}  // namespace b3dgs
