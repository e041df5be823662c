// Anti-aliasing after Yu et al. 2024, "Mip-Splatting", on one Gaussian.
//
// 3D smoothing filter (equation 9): the Gaussian is convolved with an isotropic one of standard deviation f, about the
// size of the finest detail that any photograph can show of it: scales s become sqrt(s^2 + f^2).
// 2D filter (equation 10): the blur of the projection stays, kCovarianceBlur.
// Both keep a Gaussian's integral, and so multiply its opacity by the ratio of the determinants' square roots before
// and after; without that, a Gaussian smaller than a pixel becomes brighter the smaller the image is.
#pragma once

#include <cmath>

#include "core/vec.h"
#include "raster/math/projection.h"

namespace b3dgs {

/// Smallest ratio of determinants that the 2D filter accounts for. Below it the factor of the opacity is constant, its
/// square root, and has no gradient.
inline constexpr float kMinBlurRatio = 2.5e-5f;

/// A Gaussian's shape behind the 3D filter.
template <class Real>
struct Smoothed {
  Vec3<Real> log_scales;   // 0.5 ln(s^2 + f^2)
  Vec3<Real> share;        // s^2 / (s^2 + f^2), each: d(smoothed log scale) / d(log scale)
  Real log_opacity_ratio;  // ln of the opacity's factor, sum of 0.5 ln(share)
};

template <class Real>
B3DGS_HD Smoothed<Real> smooth(Vec3<Real> log_scales, Real filter) {
  using std::exp;
  using std::log;
  Smoothed<Real> smoothed;
  const auto share = [filter](Real log_scale) {
    // Relative to the scale; bounded, so that the share does not vanish. At the bound nothing is left of the opacity.
    constexpr Real kMaxRatio = Real(1e15);
    const Real ratio = filter * exp(-log_scale);
    const Real bounded = ratio < kMaxRatio ? ratio : kMaxRatio;
    return 1 / (1 + bounded * bounded);
  };
  smoothed.share = {share(log_scales.x), share(log_scales.y), share(log_scales.z)};
  const Vec3<Real> half_log{log(smoothed.share.x) / 2, log(smoothed.share.y) / 2, log(smoothed.share.z) / 2};
  smoothed.log_scales = log_scales - half_log;
  smoothed.log_opacity_ratio = half_log.x + half_log.y + half_log.z;
  return smoothed;
}

/// Factor by which the 2D filter multiplies the opacity, as the square of it: det(cov without blur) / det(cov), at
/// least kMinBlurRatio.
template <class Real>
B3DGS_HD Real blur_ratio(const Projection<Real>& p) {
  const Real ratio = p.sharp_det / p.det;
  return ratio > Real(kMinBlurRatio) ? ratio : Real(kMinBlurRatio);
}

/// Gradient through the 2D filter's factor of the opacity. `q` is dL/d(ln alpha), summed over pixels.
///
/// With a, b = spread_x, spread_y, c = a x b, sharp_det = c . c and cov = [a.a, a.b; a.b, b.b] + blur:
///   d(ln(sharp_det) / 2) = (b x c . da + c x a . db) / sharp_det
///   d(ln(det) / 2) = (K.xx a + K.xy b) . da + (K.xy a + K.yy b) . db   with K the conic
template <class Real>
B3DGS_HD SpreadGrad<Real> blur_ratio_backward(const Projection<Real>& p, Real q) {
  if (!(p.sharp_det > Real(kMinBlurRatio) * p.det)) return {};
  const Vec3<Real> a = p.spread_x, b = p.spread_y, c = cross(a, b);
  const Real k = q / p.sharp_det;
  return {k * cross(b, c) - (q * p.conic.xx) * a - (q * p.conic.xy) * b,
          k * cross(c, a) - (q * p.conic.xy) * a - (q * p.conic.yy) * b};
}

}  // namespace b3dgs
