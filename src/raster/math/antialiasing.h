// Anti-aliasing as in Mip-Splatting (Yu et al. 2024), for one Gaussian.
//
// The 3D smoothing filter (equation 9) convolves the Gaussian with an isotropic one of standard deviation f, about the
// size of the finest detail that any photograph can show of it. Its scales s become sqrt(s^2 + f^2).
// The 2D filter (equation 10) blurs the projection as without anti-aliasing (kCovarianceBlur).
// Both filters preserve a Gaussian's integral: they multiply its opacity by sqrt(determinant before / determinant
// after). Without that, a Gaussian smaller than a pixel becomes brighter the smaller the image is.
#pragma once

#include <cmath>
#include <cstdint>

#include "core/vec.h"
#include "raster/math/projection.h"

namespace b3dgs {

/// Lower bound of the determinant ratio of the 2D filter. Below it, the factor of the opacity is the square root of the
/// bound, which is constant and has no gradient.
inline constexpr float kMinBlurRatio = 2.5e-5f;

/// A Gaussian after the 3D filter.
template <class Real>
struct Smoothed {
  Vec3<Real> log_scales;   // 0.5 ln(s^2 + f^2)
  Vec3<Real> share;        // s^2 / (s^2 + f^2) per axis: d(smoothed log scale) / d(log scale)
  Real log_opacity_ratio;  // ln of the opacity factor, sum of 0.5 ln(share)
};

/// Applies the 3D filter. `filter` is its standard deviation f in world units.
template <class Real>
B3DGS_HD Smoothed<Real> smooth(Vec3<Real> log_scales, Real filter) {
  using std::exp;
  using std::log;
  Smoothed<Real> smoothed;
  const auto share = [filter](Real log_scale) {
    // Relative to the scale. Bounded so that the share does not underflow. At the bound, opacity is practically 0.
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

/// Applies the 3D filter to Gaussian i if antialiasing is on and `filters` ([N] or null) is not null.
template <bool kAntialiasing>
B3DGS_HD Smoothed<float> smooth_if([[maybe_unused]] const float* filters, [[maybe_unused]] std::int64_t i,
                                   Vec3f log_scales) {
  if constexpr (kAntialiasing) {
    if (filters != nullptr) return smooth(log_scales, filters[i]);
  }
  return {log_scales, {1, 1, 1}, 0};
}

/// Returns the square of the factor by which the 2D filter multiplies the opacity: det(cov without blur) / det(cov), at
/// least kMinBlurRatio.
template <class Real>
B3DGS_HD Real blur_ratio(const Projection<Real>& p) {
  const Real ratio = p.sharp_det / p.det;
  return ratio > Real(kMinBlurRatio) ? ratio : Real(kMinBlurRatio);
}

/// Returns the gradient through the opacity factor of the 2D filter. `grad_log_alpha` is dL/d(ln alpha), summed over
/// pixels.
///
/// With a, b = spread_x, spread_y, c = a x b, sharp_det = c . c and cov = [a.a, a.b; a.b, b.b] + blur:
///   d(ln(sharp_det) / 2) = (b x c . da + c x a . db) / sharp_det
///   d(ln(det) / 2) = (K.xx a + K.xy b) . da + (K.xy a + K.yy b) . db   with K the conic
template <class Real>
B3DGS_HD SpreadGrad<Real> blur_ratio_backward(const Projection<Real>& p, Real grad_log_alpha) {
  if (!(p.sharp_det > Real(kMinBlurRatio) * p.det)) return {};
  const Vec3<Real> a = p.spread_x, b = p.spread_y, c = cross(a, b);
  const Real k = grad_log_alpha / p.sharp_det;
  return {k * cross(b, c) - (grad_log_alpha * p.conic.xx) * a - (grad_log_alpha * p.conic.xy) * b,
          k * cross(c, a) - (grad_log_alpha * p.conic.xy) * a - (grad_log_alpha * p.conic.yy) * b};
}

}  // namespace b3dgs
