// What a kind of lens is, and the families of lenses that COLMAP knows: functions that distort a point, given the
// coefficients of one camera.
#pragma once

#include <array>
#include <cmath>
#include <cstddef>
#include <vector>

#include "raster/view_lens.h"
#include "scene/cameras/camera.h"
#include "scene/images/image.h"

namespace b3dgs {

/// Points (x, y) lie on the plane z = 1 in front of the camera, r is their distance from the axis, and `k` points to
/// the camera's coefficients: COLMAP's parameters of the model after focal lengths and principal point.
struct LensModel {
  /// Radial part of the distortion: the distorted radius divided by r.
  double (*radial_factor)(const double* k, double r);
  /// All of the distortion: from the undistorted point to the distorted one. Null: it is radial only.
  std::array<double, 2> (*distort)(const double* k, double x, double y);
  /// Whether a camera whose coefficients are all 0 is a pinhole. A fisheye is not: it is the equidistant projection.
  bool is_pinhole_at_zero;
  /// For cameras that keep their lens: its kind, and where in LensParams::k each coefficient goes.
  LensKind kind;
  std::array<std::size_t, 8> places;
};

/// 1 + c[0] s + c[1] s^2 + ... + c[N - 1] s^N
template <std::size_t N>
double polynomial(const double* c, double s) {
  double sum = 0;
  for (std::size_t i = N; i-- > 0;) sum = (sum + c[i]) * s;
  return 1 + sum;
}

// SIMPLE_PINHOLE, PINHOLE (N = 0), SIMPLE_RADIAL and RADIAL.

/// N coefficients: the radius becomes r (1 + k1 r^2 + k2 r^4 + ...).
template <std::size_t N>
double radial_factor(const double* k, double r) {
  return polynomial<N>(k, r * r);
}

template <std::size_t N>
inline constexpr LensModel kRadialLens{radial_factor<N>, nullptr, true, LensKind::kDistorted, {0, 1}};
inline constexpr const LensModel& kPinholeLens = kRadialLens<0>;

// OPENCV and FULL_OPENCV: OpenCV's camera model, radial and tangential.

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

inline constexpr LensModel kOpenCvLens{
    radial_factor<2>, distort_tangentially<radial_factor<2>>, true, LensKind::kDistorted, {0, 1, 7, 8}};
inline constexpr LensModel kFullOpenCvLens{full_opencv_radial_factor,
                                           distort_tangentially<full_opencv_radial_factor>,
                                           true,
                                           LensKind::kDistorted,
                                           {0, 1, 7, 8, 2, 4, 5, 6}};

// SIMPLE_RADIAL_FISHEYE, RADIAL_FISHEYE and OPENCV_FISHEYE: the equidistant projection with radial distortion.
// SIMPLE_FISHEYE and FISHEYE: without (N = 0).

/// N coefficients: with theta = atan(r) the radius becomes theta (1 + k1 theta^2 + k2 theta^4 + ...).
template <std::size_t N>
double fisheye_radial_factor(const double* k, double r) {
  const double theta = std::atan(r);
  return (r > 1e-12 ? theta / r : 1.0) * polynomial<N>(k, theta * theta);
}

template <std::size_t N>
inline constexpr LensModel kFisheyeLens{fisheye_radial_factor<N>, nullptr, false, LensKind::kFisheye, {0, 1, 2, 3}};

// THIN_PRISM_FISHEYE: the equidistant projection with radial, tangential and thin-prism distortion, as the ETH3D
// benchmark defines it (Weng et al. 1992 for the thin prism).

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

inline constexpr LensModel kThinPrismFisheyeLens{
    thin_prism_radial_factor, distort_thin_prism, false, LensKind::kFisheye, {0, 1, 7, 8, 2, 3, 9, 10}};

// FOV, SIMPLE_DIVISION, DIVISION and EUCM: one or two coefficients and a closed form.

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

inline constexpr LensModel kFovLens{fov_radial_factor, nullptr, true, LensKind::kFov, {0}};
inline constexpr LensModel kDivisionLens{division_radial_factor, nullptr, true, LensKind::kDivision, {0}};
inline constexpr LensModel kEucmLens{eucm_radial_factor, nullptr, true, LensKind::kEucm, {0, 1}};

// EQUIRECTANGULAR: a panorama, which has no place on the plane z = 1 behind the camera and is never undistorted.

inline constexpr LensModel kEquirectangularLens{radial_factor<0>, nullptr, false, LensKind::kEquirectangular, {}};

// The lens of one camera: intrinsics and distortion, from the ideal pinhole to the photograph.

struct Lens {
  double fx = 0, fy = 0, cx = 0, cy = 0;  // px; the centre of the upper left pixel is at (0.5, 0.5)
  const LensModel* model = &kPinholeLens;
  std::vector<double> coefficients = {};  // as many as the model has, in its order

  /// Whether photographs need no undistortion.
  bool is_pinhole() const;
  /// The same lens for an image of another size.
  Lens scaled(double sx, double sy) const;
  /// Of a camera that keeps this lens, without its largest angle (native_camera()).
  LensParams<double> params() const;
  /// The camera of undistorted images of this size, without a pose: same focal lengths and principal point.
  Camera pinhole(ImageSize size) const;
};

/// Of a panorama of this size.
Lens equirectangular_lens(ImageSize size);

/// Undistorted to distorted point, both on the plane z = 1.
std::array<double, 2> distort(const Lens& lens, double x, double y);

/// Largest undistorted radius up to `limit` below which the distorted radius grows. Beyond it the polynomial, which was
/// fitted to the photograph only, maps points outside the field of view back into the photograph.
double monotonic_radius(const Lens& lens, double limit);

}  // namespace b3dgs
