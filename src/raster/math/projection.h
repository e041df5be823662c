// Projection from world space to one image, and its gradient. The centre uses perspective. The shape uses the local
// affine approximation of EWA splatting (Zwicker et al. 2001; 3DGS, eq. 5): cov2d = J W Sigma W^T J^T + blur.
#pragma once

#include <cmath>

#include "core/vec.h"
#include "raster/args.h"
#include "raster/constants.h"
#include "raster/math/covariance.h"
#include "raster/math/lens.h"

namespace b3dgs {

/// PinholeView as Real, with the limits of the linearisation.
template <class Real>
struct ViewTransform : LensScale<Real> {
  Mat3<Real> rotation;
  Vec3<Real> translation;
  // Range of x/z and y/z. Outside it, J is evaluated at the nearest limit instead of at the Gaussian's centre.
  Real x_min, x_max, y_min, y_max;
};

template <class Real>
B3DGS_HD ViewTransform<Real> make_view_transform(const PinholeView& view) {
  ViewTransform<Real> t;
  for (int i = 0; i < 9; ++i) t.rotation.m[i] = view.rotation.m[i];
  t.translation = {view.translation.x, view.translation.y, view.translation.z};
  t.fx = view.fx;
  t.fy = view.fy;
  t.cx = view.cx;
  t.cy = view.cy;
  const Real margin_x = Real(kFrustumMargin) * view.width / (2 * t.fx);
  const Real margin_y = Real(kFrustumMargin) * view.height / (2 * t.fy);
  t.x_min = -t.cx / t.fx - margin_x;
  t.x_max = (view.width - t.cx) / t.fx + margin_x;
  t.y_min = -t.cy / t.fy - margin_y;
  t.y_max = (view.height - t.cy) / t.fy + margin_y;
  return t;
}

template <class Real>
B3DGS_HD Vec3<Real> row_of(const Mat3<Real>& m, int row) {
  return {m(row, 0), m(row, 1), m(row, 2)};
}

template <class Real>
B3DGS_HD Vec3<Real> to_camera(const ViewTransform<Real>& view, Vec3<Real> mean) {
  return view.rotation * mean + view.translation;
}

/// A Gaussian's ellipse in the image, with the intermediate values that project_backward() needs.
template <class Real>
struct Projection {
  Vec2<Real> mean2d;  // px
  Sym2<Real> cov;     // px^2, blur included
  Real det;           // of cov, at least kCovarianceBlur^2
  Real sharp_det;     // of cov without the blur
  Sym2<Real> conic;   // inverse of cov, 1/px^2

  Vec3<Real> axis_x, axis_y;      // rows of J W: d(pixel) / d(world), px per world unit
  Vec3<Real> spread_x, spread_y;  // M^T axis: cov.xy = spread_x . spread_y
  Real slope_x, slope_y;          // x/z and y/z at which J is evaluated
  bool slope_x_clamped, slope_y_clamped;
  // For lenses, these replace the slopes: the point where J is evaluated, and the factor lens_shrink() of J.
  LensPlace<Real> place;
  Real shrink;
};

/// Computes the ellipse from the axes. The determinant is a sum of positive terms (Lagrange's identity), so thin splats
/// keep an invertible covariance in single precision.
template <class Real>
B3DGS_HD void set_ellipse(Projection<Real>& p, const Mat3<Real>& factor) {
  p.spread_x = transpose_times(factor, p.axis_x);
  p.spread_y = transpose_times(factor, p.axis_y);

  const Real blur = Real(kCovarianceBlur);
  const Real xx = dot(p.spread_x, p.spread_x), yy = dot(p.spread_y, p.spread_y);
  const Vec3<Real> normal = cross(p.spread_x, p.spread_y);
  p.cov = {xx + blur, dot(p.spread_x, p.spread_y), yy + blur};
  p.sharp_det = dot(normal, normal);
  p.det = p.sharp_det + blur * (xx + yy) + blur * blur;
  const Real inverse_det = 1 / p.det;
  p.conic = {p.cov.yy * inverse_det, -p.cov.xy * inverse_det, p.cov.xx * inverse_det};
}

/// Projects through a pinhole. `point` is the centre in camera coordinates, `factor` the M of make_shape.
template <class Real>
B3DGS_HD Projection<Real> project_gaussian(const ViewTransform<Real>& view, const Pinhole&, Vec3<Real> point,
                                           const Mat3<Real>& factor) {
  Projection<Real> p;
  const Real inverse_z = 1 / point.z;
  const Real u = point.x * inverse_z, v = point.y * inverse_z;
  p.mean2d = {view.fx * u + view.cx, view.fy * v + view.cy};

  p.slope_x = u < view.x_min ? view.x_min : (u > view.x_max ? view.x_max : u);
  p.slope_y = v < view.y_min ? view.y_min : (v > view.y_max ? view.y_max : v);
  p.slope_x_clamped = u < view.x_min || u > view.x_max;
  p.slope_y_clamped = v < view.y_min || v > view.y_max;
  const Vec3<Real> row_z = row_of(view.rotation, 2);
  p.axis_x = (view.fx * inverse_z) * (row_of(view.rotation, 0) - p.slope_x * row_z);
  p.axis_y = (view.fy * inverse_z) * (row_of(view.rotation, 1) - p.slope_y * row_z);
  set_ellipse(p, factor);
  return p;
}

/// Returns the largest standard deviation of a Gaussian, from M = R S.
template <class Real>
B3DGS_HD Real longest_axis(const Mat3<Real>& factor) {
  using std::sqrt;
  Real most = 0;
  for (int k = 0; k < 3; ++k) {
    const Vec3<Real> axis{factor(0, k), factor(1, k), factor(2, k)};
    const Real square = dot(axis, axis);
    most = square > most ? square : most;
  }
  return sqrt(most);
}

/// Projects with the affine approximation at place.at, which is the centre unless it is clamped.
template <class Real>
B3DGS_HD Projection<Real> project_gaussian(const ViewTransform<Real>& view, const LensParams<Real>& lens,
                                           Vec3<Real> point, const Mat3<Real>& factor) {
  Projection<Real> p;
  p.place = lens_place(lens, point);
  const LensPoint<Real> seen = lens_point(lens, view, p.place.at);
  const Vec3<Real> beyond = point - p.place.at;
  p.mean2d = {seen.pixel.x + dot(seen.row_x, beyond), seen.pixel.y + dot(seen.row_y, beyond)};
  p.shrink = lens_shrink(lens, point, longest_axis(factor));
  p.axis_x = p.shrink * transpose_times(view.rotation, seen.row_x);
  p.axis_y = p.shrink * transpose_times(view.rotation, seen.row_y);
  set_ellipse(p, factor);
  return p;
}

template <class Real>
B3DGS_HD Real lens_depth(const Pinhole&, const Vec3<Real>& point) {
  return point.z;
}

/// Returns the larger standard deviation of the ellipse, px.
template <class Real>
B3DGS_HD Real largest_sigma(const Sym2<Real>& cov) {
  using std::sqrt;
  const Real half_difference = (cov.xx - cov.yy) / 2;
  return sqrt((cov.xx + cov.yy) / 2 + sqrt(half_difference * half_difference + cov.xy * cov.xy));
}

/// Returns the gradient with respect to the projected centre, 1/px, from SplatGrad::mean.
template <class Real>
B3DGS_HD Vec2<Real> centre_gradient(Vec2<Real> grad_mean) {
  const Real scale = 1 / Real(kConicScale);
  return {scale * grad_mean.x, scale * grad_mean.y};
}

/// Gradients with respect to the quantity in each comment.
template <class Real>
struct ProjectionGrad {
  Vec3<Real> point;   // centre in camera coordinates
  Mat3<Real> factor;  // M
  Vec2<Real> mean2d;  // projected centre, 1/px
};

/// Gradient with respect to the rows of the projected shape, spread_x and spread_y.
template <class Real>
struct SpreadGrad {
  Vec3<Real> x, y;
};

/// Returns the gradient from SplatGrad::cov, the sum over pixels of g p p^T.
///
/// With sigma = d^T K d / 2, d = pixel - mean, K d = p / kConicScale and g = dL/d(ln alpha) = -dL/d(sigma):
///   dL/dmean = sum(g K d),   dL/dcov = sum(g K d (K d)^T) / 2   (as a full matrix).
template <class Real>
B3DGS_HD SpreadGrad<Real> spread_grad(const Projection<Real>& p, Sym2<Real> grad_cov) {
  const Real scale = 1 / Real(kConicScale);
  // cov.xx = a . a, cov.xy = a . b, cov.yy = b . b with a, b = spread_x, spread_y = M^T axis.
  const Sym2<Real> twice{scale * scale * grad_cov.xx, scale * scale * grad_cov.xy,
                         scale * scale * grad_cov.yy};  // 2 dL/dcov
  return {twice.xx * p.spread_x + twice.xy * p.spread_y, twice.xy * p.spread_x + twice.yy * p.spread_y};
}

/// Sets the gradients that do not depend on the lens.
template <class Real>
B3DGS_HD void set_mean_and_factor(const Projection<Real>& p, Vec2<Real> grad_mean, const SpreadGrad<Real>& grad_spread,
                                  ProjectionGrad<Real>& grad) {
  grad.mean2d = centre_gradient(grad_mean);
  const Vec3<Real> grad_a = grad_spread.x, grad_b = grad_spread.y;
  const Real axis_x[3] = {p.axis_x.x, p.axis_x.y, p.axis_x.z}, axis_y[3] = {p.axis_y.x, p.axis_y.y, p.axis_y.z};
  for (int row = 0; row < 3; ++row) {
    grad.factor(row, 0) = axis_x[row] * grad_a.x + axis_y[row] * grad_b.x;
    grad.factor(row, 1) = axis_x[row] * grad_a.y + axis_y[row] * grad_b.y;
    grad.factor(row, 2) = axis_x[row] * grad_a.z + axis_y[row] * grad_b.z;
  }
}

/// Projects back through a pinhole. `grad_mean` is SplatGrad::mean, the sum over pixels of g p.
template <class Real>
B3DGS_HD ProjectionGrad<Real> project_backward(const ViewTransform<Real>& view, const Pinhole&, Vec3<Real> point,
                                               const Mat3<Real>& factor, const Projection<Real>& p,
                                               Vec2<Real> grad_mean, const SpreadGrad<Real>& grad_spread,
                                               Real grad_depth) {
  ProjectionGrad<Real> grad;
  set_mean_and_factor(p, grad_mean, grad_spread, grad);
  const Vec3<Real> grad_axis_x = factor * grad_spread.x, grad_axis_y = factor * grad_spread.y;

  // axis = f / z (row - slope row_z), with slope = x / z unless it is clamped.
  const Real inverse_z = 1 / point.z;
  const Vec3<Real> row_z = row_of(view.rotation, 2);
  const Real grad_slope_x = p.slope_x_clamped ? Real(0) : -view.fx * inverse_z * dot(row_z, grad_axis_x);
  const Real grad_slope_y = p.slope_y_clamped ? Real(0) : -view.fy * inverse_z * dot(row_z, grad_axis_y);
  // The projected centre depends on x/z and y/z whether or not J is clamped.
  const Real grad_u = grad_slope_x + view.fx * grad.mean2d.x;
  const Real grad_v = grad_slope_y + view.fy * grad.mean2d.y;
  const Real through_axes = dot(p.axis_x, grad_axis_x) + dot(p.axis_y, grad_axis_y);
  grad.point = {grad_u * inverse_z, grad_v * inverse_z,
                grad_depth - inverse_z * (through_axes + (grad_u * point.x + grad_v * point.y) * inverse_z)};
  return grad;
}

/// The factor by which a Gaussian is shrunk has no gradient.
template <class Real>
B3DGS_HD ProjectionGrad<Real> project_backward(const ViewTransform<Real>& view, const LensParams<Real>& lens,
                                               Vec3<Real> point, const Mat3<Real>& factor, const Projection<Real>& p,
                                               Vec2<Real> grad_mean, const SpreadGrad<Real>& grad_spread,
                                               Real grad_depth) {
  ProjectionGrad<Real> grad;
  set_mean_and_factor(p, grad_mean, grad_spread, grad);
  // Compute the rows of J from those of J W.
  const Vec3<Real> row_x = (1 / p.shrink) * (view.rotation * p.axis_x);
  const Vec3<Real> row_y = (1 / p.shrink) * (view.rotation * p.axis_y);
  grad.point = grad.mean2d.x * row_x + grad.mean2d.y * row_y;
  // The centre is at row_x (c - at) from the pixel of the linearisation point, so the derivatives of that point cancel,
  // and those of the rows remain.
  const Vec3<Real> beyond = point - p.place.at;  // 0 unless the point is clamped
  const Vec3<Real> grad_row_x = p.shrink * (view.rotation * (factor * grad_spread.x)) + grad.mean2d.x * beyond;
  const Vec3<Real> grad_row_y = p.shrink * (view.rotation * (factor * grad_spread.y)) + grad.mean2d.y * beyond;
  const Vec3<Real> grad_place = lens_hessian(lens, view, p.place.at, grad_row_x, grad_row_y);
  grad.point = grad.point + (p.place.is_clamped ? clamped_place_transposed(lens, point, grad_place) : grad_place);
  if (has_radial_depth(lens)) {
    grad.point = grad.point + (grad_depth / lens_depth(lens, point)) * point;
  } else {
    grad.point.z += grad_depth;
  }
  return grad;
}

}  // namespace b3dgs
