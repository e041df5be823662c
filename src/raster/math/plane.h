// The plane of a splat, from which depth and normals of a surface are blended (as in RaDe-GS, Zhang et al. 2024).
//
// In the camera frame, let mu be the centre and z its depth, r0 = mu / z, b_k the axes and s_k their standard
// deviations, lambda_k = (s_min / s_k)^2 and y_k = b_k . r0. Then
//   nu = sum of lambda_k y_k b_k
// is Sigma^-1 r0 times s_min^2, without an inverse that could overflow for thin splats. On a ray x = t r, where t is
// the depth of x, the Gaussian is largest at t = (r . A mu) / (r . A r) with A = Sigma^-1. To first order around r0,
// these peaks lie on the plane through mu with normal nu:
//   m = nu / (nu . mu)     1 / t = m . r
// For a pinhole, r is affine in the pixel, and so is 1 / t. For other lenses, 1 / t is linearised at the centre. nu is
// smooth in all parameters and tends to the thinnest axis of a flat splat, so that no axis has to be chosen.
#pragma once

#include <cmath>
#include <cstdint>
#include <type_traits>

#include "core/vec.h"
#include "raster/geometry.h"
#include "raster/math/antialiasing.h"
#include "raster/math/array_rows.h"
#include "raster/math/covariance.h"
#include "raster/math/lens.h"
#include "raster/math/projection.h"

namespace b3dgs {

// A pixel has a surface if its transmittance falls below this value.
inline constexpr float kSurfaceTransmittance = 0.5f;
// DepthKind::kSurface: the range of transmittance whose splats count.
inline constexpr float kSurfaceBandLow = 0.4f, kSurfaceBandHigh = 0.6f;
// At a pixel where the depth of a splat's plane differs from that of its centre by more than this fraction, the depth
// of the centre is used.
inline constexpr float kPlaneReach = 0.2f;

/// Camera frame.
template <class Real>
struct SplatPlane {
  Vec3<Real> m;       // 1 / depth along a ray r is m . r
  Vec3<Real> normal;  // unit, towards the camera: -nu / |nu|
  // Along r0, the Gaussian falls off as exp(-sharpness (t - z)^2): r0 . A r0 / 2, 1 / world unit^2. 0 or infinite
  // where Real does not reach.
  Real sharpness;
};

/// Returns the plane of a Gaussian. `point` is its centre in the camera frame and `depth` its depth (lens_depth()), the
/// columns of `axes` are its axes in the camera frame. If it is thinner than a millionth of its other axes and seen
/// exactly from its edge, the plane faces the camera.
template <class Real>
B3DGS_HD SplatPlane<Real> splat_plane(Vec3<Real> point, Real depth, const Mat3<Real>& axes, Vec3<Real> log_scales) {
  using std::exp;
  using std::sqrt;
  const Vec3<Real> ray = (1 / depth) * point, y = transpose_times(axes, ray);
  const Real xy = log_scales.x < log_scales.y ? log_scales.x : log_scales.y;
  const Real least = xy < log_scales.z ? xy : log_scales.z;
  const Vec3<Real> lambda{exp(2 * (least - log_scales.x)), exp(2 * (least - log_scales.y)),
                          exp(2 * (least - log_scales.z))};
  Vec3<Real> nu = axes * Vec3<Real>{lambda.x * y.x, lambda.y * y.y, lambda.z * y.z};
  Real along = dot(nu, ray);
  SplatPlane<Real> plane;
  plane.sharpness = along > 0 ? along * exp(-2 * least) / 2 : 0;
  if (!(along > Real(1e-12) * dot(ray, ray))) {
    nu = ray;
    along = dot(ray, ray);
  }
  plane.m = (1 / (along * depth)) * nu;
  plane.normal = (-1 / sqrt(dot(nu, nu))) * nu;
  return plane;
}

/// Returns the change of 1 / depth per px, given the plane `m` of a Gaussian with this centre and depth.
template <class Real>
B3DGS_HD Vec2<Real> plane_slope(const ViewTransform<Real>& view, const Pinhole&, Vec3<Real> /*point*/, Real /*depth*/,
                                Vec3<Real> m) {
  return {m.x / view.fx, m.y / view.fy};
}

/// For lenses: a step dx of the point that moves the pixel by J dx = dp and leaves the depth unchanged changes r by
/// dx / depth, so 1 / depth changes by m . dx / depth. J is that of the projection (project_gaussian()).
template <class Real>
B3DGS_HD Vec2<Real> plane_slope(const ViewTransform<Real>& view, const LensParams<Real>& lens, Vec3<Real> point,
                                Real depth, Vec3<Real> m) {
  const LensPoint<Real> seen = lens_point(lens, view, lens_place(lens, point).at);
  const Vec3<Real> deeper = has_radial_depth(lens) ? (1 / depth) * point : Vec3<Real>{0, 0, 1};  // gradient of depth
  const Vec3<Real> step_x = cross(seen.row_y, deeper), step_y = cross(deeper, seen.row_x);
  const Real scale = 1 / (dot(seen.row_x, step_x) * depth);
  return {scale * dot(m, step_x), scale * dot(m, step_y)};
}

/// Returns the plane of Gaussian i, which must be visible.
template <bool kAntialiasing, class Lens>
B3DGS_HD PlaneRow plane_row(const GaussianArrays& gaussians, std::int64_t i, const ViewTransform<float>& view,
                            const Lens& lens, DepthKind kind) {
  const Vec3f point = to_camera(view, load3(gaussians.means, i));
  const float depth = lens_depth(lens, point);
  const Vec3f log_scales = smooth_if<kAntialiasing>(gaussians.filters, i, load3(gaussians.log_scales, i)).log_scales;
  const Mat3f rotation = make_shape(Vec3f{0, 0, 0}, load4(gaussians.quats, i)).rotation;
  Mat3f axes;
  for (int row = 0; row < 3; ++row) {
    const Vec3f turned = transpose_times(rotation, row_of(view.rotation, row));
    axes(row, 0) = turned.x;
    axes(row, 1) = turned.y;
    axes(row, 2) = turned.z;
  }
  const SplatPlane<float> plane = splat_plane(point, depth, axes, log_scales);
  const float variance = 1 / (2 * plane.sharpness * depth * depth);  // the standard deviation of t is 1/sqrt(2 kappa)
  PlaneRow row{depth, 0, 0, variance < 1 ? variance : 1.0f, plane.normal, 0};
  if (kind != DepthKind::kMean) {
    const Vec2f slope = plane_slope(view, lens, point, depth, plane.m);
    row.value = 1 / depth;
    row.slope_x = slope.x;
    row.slope_y = slope.y;
  }
  return row;
}

/// Sums of a pixel after all of its splats (SurfacePixel in surface_blend.h).
struct SurfaceSums {
  float transmittance;  // final, not negative
  float first, share, offset, square, variance;
  Vec3f normal;
};

/// Computes and writes the geometry of pixel (x, y).
B3DGS_HD void store_surface(const GeometryArgs& args, std::int32_t x, std::int32_t y, const SurfaceSums& sums) {
  using std::sqrt;
  const std::int64_t p = std::int64_t{y} * args.grid.image_width + x;
  float depth = 0, confidence = 0;
  Vec3f normal{0, 0, 0};
  if (sums.transmittance < kSurfaceTransmittance) {
    const float offset = sums.offset / sums.share, value = sums.first + offset;
    const float scatter = sums.square / sums.share - offset * offset;
    const float variance = (scatter > 0 ? scatter / (value * value) : 0.0f) + sums.variance / sums.share;
    depth = args.kind == DepthKind::kMean ? value : 1 / value;
    confidence = 1 / (1 + variance / (kConfidentSpread * kConfidentSpread));
    const float length = sqrt(dot(sums.normal, sums.normal));
    if (length > 0) normal = (1 / length) * sums.normal;
  }
  args.out.depth[p] = depth;
  args.out.confidence[p] = confidence;
  store3(args.out.normal, p, normal);
}

}  // namespace b3dgs
