// From a splat's sums over pixels to its part of the gradient with respect to the camera's pose, for pose refinement.
#pragma once

#include <cstdint>

#include "raster/math/gaussian_grad.h"

namespace b3dgs {

/// Gradient of the loss with respect to a small motion of the camera, in its own frame: a rotation vector w (rad) about
/// the camera's centre and a translation v (world units), which move each point to
///   x_camera + w x x_camera + v
struct CameraGrad {
  Vec3f rotation;     // 1/rad
  Vec3f translation;  // 1/world unit
};

/// The part of Gaussian i, which the view sees; arguments as for gaussian_grad().
///
/// A translation of the camera acts like one of the Gaussian, viewing direction included, so its gradient is that of
/// the mean. A rotation about the camera's centre acts like one of the Gaussian about that point, except that viewing
/// directions stay: with x the offset of the mean from the camera's centre, F the gradient with respect to the mean
/// through the projection alone and g the one with respect to the quaternion q, and everything in world space,
///   dL/dw = x x F + (q.w g.xyz - g.w q.xyz + q.xyz x g.xyz) / 2,   since dq = (0, w) q / 2
template <bool kAntialiasing>
B3DGS_HD CameraGrad camera_grad(const GaussianArrays& g, std::int64_t i, const ViewTransform<float>& view,
                                const Vec3f& camera_center, int sh_degree, const SplatGrad& sum, unsigned clamped) {
  const GaussianGrad grad = gaussian_grad<kAntialiasing>(g, i, view, camera_center, sh_degree, sum, clamped);
  const Vec3f offset = load3(g.means, i) - camera_center;
  const Vec3f through_color =
      sh_offset_grad(sh_degree, offset, g.shN + rest_floats(g.sh_degree_max) * i, grad.color).offset;
  const Vec4f quat = load4(g.quats, i);  // w x y z
  const Vec3f axis{quat.y, quat.z, quat.w}, grad_axis{grad.quat.y, grad.quat.z, grad.quat.w};
  const Vec3f through_shape = 0.5f * (quat.x * grad_axis - grad.quat.x * axis + cross(axis, grad_axis));
  return {view.rotation * (cross(offset, grad.mean - through_color) + through_shape), view.rotation * grad.mean};
}

}  // namespace b3dgs
