// OPENCV and FULL_OPENCV: OpenCV's camera model, radial and tangential.
#pragma once

#include "scene/cameras/models/lens_model.h"

namespace b3dgs {

/// k = k1, k2, p1, p2: the radius becomes r (1 + k1 r^2 + k2 r^4).
inline double opencv_radial_factor(const double* k, double r) {
  return polynomial<2>(k, r * r);
}

/// k = k1, k2, p1, p2, k3, k4, k5, k6: r (1 + k1 r^2 + k2 r^4 + k3 r^6) / (1 + k4 r^2 + k5 r^4 + k6 r^6).
inline double full_opencv_radial_factor(const double* k, double r) {
  const double numerator[3] = {k[0], k[1], k[4]};
  return polynomial<3>(numerator, r * r) / polynomial<3>(k + 5, r * r);
}

/// Adds the tangential part, p1 and p2.
template <double (*radial_factor)(const double*, double)>
std::array<double, 2> distort_tangentially(const double* k, double x, double y) {
  const double r2 = x * x + y * y, p1 = k[2], p2 = k[3];
  const double factor = radial_factor(k, std::sqrt(r2));
  return {x * factor + 2 * p1 * x * y + p2 * (r2 + 2 * x * x), y * factor + 2 * p2 * x * y + p1 * (r2 + 2 * y * y)};
}

inline constexpr LensModel kOpenCvLens{opencv_radial_factor, distort_tangentially<opencv_radial_factor>, true};
inline constexpr LensModel kFullOpenCvLens{full_opencv_radial_factor, distort_tangentially<full_opencv_radial_factor>,
                                           true};

}  // namespace b3dgs
