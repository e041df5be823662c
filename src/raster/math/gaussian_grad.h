// The end of the backward pass, one Gaussian at a time: turns a splat's sums over pixels (SplatGrad) into the gradient
// of its Gaussian's stored parameters. Also stores a splat if this happens later, and computes a splat's part of the
// gradient with respect to the camera's pose, for pose refinement.
#pragma once

#include <cstdint>

#include "raster/args.h"
#include "raster/math/antialiasing.h"
#include "raster/math/array_rows.h"
#include "raster/math/opacity.h"
#include "raster/math/projection.h"
#include "raster/math/sh.h"

namespace b3dgs {

/// Gradient of the loss with respect to one Gaussian's stored parameters and its projected centre (1/px). All zero if
/// the Gaussian is not visible. The gradient with respect to SH coefficient k is basis_k(dir) * color and is not stored
/// here.
struct GaussianGrad {
  Vec3f mean, log_scales;
  Vec4f quat;
  float logit_opacity;
  Vec2f mean2d;
  Vec3f color;  // gradient of the colour before the clamp at 0
  Vec3f dir;    // unit vector from the camera centre to the Gaussian
  B3DGS_HD Vec3f sh0() const { return static_cast<float>(kSh0) * color; }
};

/// Returns the gradient of Gaussian i, which must be visible. `sum` contains the sums of its splat. Bit c of `clamped`
/// is set if colour channel c was clamped at 0, which stops that channel's gradient. `lens`: Pinhole or ViewLens.
template <bool kAntialiasing, class Lens>
B3DGS_HD GaussianGrad gaussian_grad(const GaussianArrays& g, std::int64_t i, const ViewTransform<float>& view,
                                    const Lens& lens, const Vec3f& camera_center, int sh_degree, const SplatGrad& sum,
                                    unsigned clamped) {
  const Vec3f mean = load3(g.means, i);
  const Vec3f point = to_camera(view, mean);
  const Vec3f log_scales = load3(g.log_scales, i);
  const Smoothed<float> smoothed = smooth_if<kAntialiasing>(g.filters, i, log_scales);
  const Shape<float> shape = make_shape(smoothed.log_scales, load4(g.quats, i));
  const Projection<float> p = project_gaussian(view, lens, point, shape.factor);
  SpreadGrad<float> grad_spread = spread_grad(p, Sym2f{sum.cov_xx, sum.cov_xy, sum.cov_yy});
  if constexpr (kAntialiasing) {
    const SpreadGrad<float> through_blur = blur_ratio_backward(p, sum.log_alpha);
    grad_spread = {grad_spread.x + through_blur.x, grad_spread.y + through_blur.y};
  }
  const ProjectionGrad<float> grad =
      project_backward(view, lens, point, shape.factor, p, Vec2f{sum.mean_x, sum.mean_y}, grad_spread, sum.depth);
  ShapeGrad<float> grad_shape = shape_backward(shape, grad.factor);
  if constexpr (kAntialiasing) {
    // d(smoothed log scale) / d(log scale) is the share, and d(ln of the opacity factor) is 1 - share.
    const Vec3f share = smoothed.share;
    grad_shape.log_scales = {share.x * grad_shape.log_scales.x + sum.log_alpha * (1 - share.x),
                             share.y * grad_shape.log_scales.y + sum.log_alpha * (1 - share.y),
                             share.z * grad_shape.log_scales.z + sum.log_alpha * (1 - share.z)};
  }
  const Vec3f grad_color{clamped & 1u ? 0.0f : sum.red, clamped & 2u ? 0.0f : sum.green,
                         clamped & 4u ? 0.0f : sum.blue};
  const ShOffsetGrad<float> grad_sh =
      sh_offset_grad(sh_degree, mean - camera_center, g.shN + rest_floats(g.sh_degree_max) * i, grad_color);
  return {transpose_times(view.rotation, grad.point) + grad_sh.offset,
          grad_shape.log_scales,
          grad_shape.quat,
          logit_grad(sum.log_alpha, g.logit_opacities[i]),
          grad.mean2d,
          grad_color,
          grad_sh.dir};
}

/// Writes record m for Gaussian i.
B3DGS_HD void keep_splat(const SplatRecordArrays& out, std::int64_t m, std::int32_t i, const SplatGrad& sum,
                         std::uint32_t clamped) {
  out.records[m] = {sum, i, clamped};
  out.record_of_gaussian[i] = static_cast<std::int32_t>(m);
  const Vec2f centre = centre_gradient(Vec2f{sum.mean_x, sum.mean_y});
  out.means2d[2 * std::int64_t{i}] = centre.x;
  out.means2d[2 * std::int64_t{i} + 1] = centre.y;
}

/// Writes all outputs of row m, whose sums are complete. Gaussians without a splat are written elsewhere.
B3DGS_HD void keep_splat(const KeepSplatsArgs& args, std::int64_t m) {
  const std::int32_t i = args.rows.splats[m].gaussian;
  keep_splat(args.out, m, i, args.splat_grads[m].sum, args.rows.splats[m].clamped);
  args.radii[i] = args.rows.radii[m];
}

/// Gradient of the loss with respect to a small motion of the camera in its own frame: a rotation vector w (rad) about
/// the camera's centre and a translation v (world units), which move each point to
///   x_camera + w x x_camera + v
struct CameraGrad {
  Vec3f rotation;     // 1/rad
  Vec3f translation;  // 1/world unit
};

/// Returns the contribution of Gaussian i, which must be visible. The arguments are those of gaussian_grad().
///
/// A translation of the camera acts like one of the Gaussian, viewing direction included, so its gradient is that of
/// the mean. A rotation about the camera's centre acts like one of the Gaussian about that point, except that viewing
/// directions stay. Let x be the offset of the mean from the camera's centre, F the gradient with respect to the mean
/// through the projection alone and g the one with respect to the quaternion q, all in world space. Then
///   dL/dw = x x F + (q.w g.xyz - g.w q.xyz + q.xyz x g.xyz) / 2,   since dq = (0, w) q / 2
template <bool kAntialiasing, class Lens>
B3DGS_HD CameraGrad camera_grad(const GaussianArrays& g, std::int64_t i, const ViewTransform<float>& view,
                                const Lens& lens, const Vec3f& camera_center, int sh_degree, const SplatGrad& sum,
                                unsigned clamped) {
  const GaussianGrad grad = gaussian_grad<kAntialiasing>(g, i, view, lens, camera_center, sh_degree, sum, clamped);
  const Vec3f offset = load3(g.means, i) - camera_center;
  const Vec3f through_color =
      sh_offset_grad(sh_degree, offset, g.shN + rest_floats(g.sh_degree_max) * i, grad.color).offset;
  const Vec4f quat = load4(g.quats, i);  // w x y z
  const Vec3f axis{quat.y, quat.z, quat.w}, grad_axis{grad.quat.y, grad.quat.z, grad.quat.w};
  const Vec3f through_shape = 0.5f * (quat.x * grad_axis - grad.quat.x * axis + cross(axis, grad_axis));
  return {view.rotation * (cross(offset, grad.mean - through_color) + through_shape), view.rotation * grad.mean};
}

}  // namespace b3dgs
