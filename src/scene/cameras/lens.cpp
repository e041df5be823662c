#include "scene/cameras/lens.h"

#include <cmath>
#include <cstddef>

namespace b3dgs {
namespace {

/// 1 + c[0] s + c[1] s^2 + ... + c[N - 1] s^N
template <std::size_t N>
double polynomial(const double* c, double s) {
  double sum = 0;
  for (std::size_t i = N; i-- > 0;) sum = (sum + c[i]) * s;
  return 1 + sum;
}

double over_radius(double angle, double r) {
  return r > 1e-12 ? angle / r : 1.0;
}

/// Radial part of the distortion: the distorted radius divided by r.
double radial_factor(const LensParams<double>& lens, double r) {
  const double* const k = lens.k;
  switch (lens.kind) {
    case LensKind::kPinhole:
    case LensKind::kEquirectangular:
      return 1;
    case LensKind::kDistorted:
      return polynomial<4>(k, r * r) / polynomial<3>(k + 4, r * r);
    case LensKind::kFisheye: {
      const double theta = std::atan(r);
      return over_radius(theta, r) * (polynomial<4>(k, theta * theta) / polynomial<3>(k + 4, theta * theta));
    }
    case LensKind::kFov: {  // atan(2 r tan(omega / 2)) / omega: Devernay and Faugeras 2001
      const double slope = 2 * std::tan(k[0] / 2);
      return (r > 1e-12 ? std::atan(r * slope) / r : slope) / k[0];
    }
    case LensKind::kDivision:
      // The distorted radius s satisfies r = s / (1 + k s^2) (Fitzgibbon 2001). NaN where no s does, for k > 0.
      return 2 / (1 + std::sqrt(1 - 4 * k[0] * r * r));
    case LensKind::kEucm:  // r / (alpha sqrt(beta r^2 + 1) + 1 - alpha): Khomutenko et al. 2016
      return 1 / (k[0] * std::sqrt(k[1] * r * r + 1) + 1 - k[0]);
  }
  return 1;
}

}  // namespace

std::array<double, 2> distort(const LensParams<double>& lens, double x, double y) {
  const double r2 = x * x + y * y, r = std::sqrt(r2), factor = radial_factor(lens, r);
  const bool is_fisheye = lens.kind == LensKind::kFisheye;
  if (lens.kind != LensKind::kDistorted && !is_fisheye) return {x * factor, y * factor};
  // Tangential and thin-prism distortion (Weng et al. 1992); of a fisheye, of the point of the equidistant projection,
  // at distance theta from the axis.
  const double theta = std::atan(r), scale = is_fisheye ? over_radius(theta, r) : 1.0;
  const double u = x * scale, v = y * scale, s = is_fisheye ? theta * theta : r2;
  const double p1 = lens.k[7], p2 = lens.k[8], s1 = lens.k[9], s2 = lens.k[10];
  return {x * factor + 2 * p1 * u * v + p2 * (s + 2 * u * u) + s1 * s,
          y * factor + 2 * p2 * u * v + p1 * (s + 2 * v * v) + s2 * s};
}

double monotonic_radius(const LensParams<double>& lens, double limit) {
  // Steps far smaller than a pixel of an image whose corner is at `limit`; a turning point between two steps moves the
  // result by less than one step.
  constexpr int kSteps = 1 << 15;
  double before = 0;
  for (int i = 1; i <= kSteps; ++i) {
    const double r = limit * i / kSteps;
    const double distorted = r * radial_factor(lens, r);
    if (!(distorted > before)) return limit * (i - 1) / kSteps;
    before = distorted;
  }
  return limit;
}

}  // namespace b3dgs
