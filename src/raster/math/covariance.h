// A Gaussian's shape in world space: the factor M of its covariance, Sigma = M M^T = R S S^T R^T (3DGS, eq. 6), and the
// gradient through it. The covariance itself is never formed, because projecting M takes fewer operations and avoids
// cancellation.
#pragma once

#include <cmath>

#include "core/vec.h"

namespace b3dgs {

/// Returns the rotation matrix of a unit quaternion.
template <class Real>
B3DGS_HD Mat3<Real> rotation_matrix(Vec4<Real> unit_quat_wxyz) {
  const Real w = unit_quat_wxyz.x, x = unit_quat_wxyz.y, y = unit_quat_wxyz.z, z = unit_quat_wxyz.w;
  return {{1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),  //
           2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),  //
           2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)}};
}

/// Shape of one Gaussian, with the intermediate values that shape_backward() needs.
template <class Real>
struct Shape {
  Mat3<Real> factor;     // M = R S
  Mat3<Real> rotation;   // R
  Vec3<Real> scales;     // exp(log_scales), world units
  Vec4<Real> unit_quat;  // w x y z
  Real inverse_length;   // 1 / |quat|
};

/// Computes the shape. `quat` is w x y z, of any length except 0.
template <class Real>
B3DGS_HD Shape<Real> make_shape(Vec3<Real> log_scales, Vec4<Real> quat) {
  using std::exp;
  using std::sqrt;
  Shape<Real> shape;
  shape.inverse_length = 1 / sqrt(quat.x * quat.x + quat.y * quat.y + quat.z * quat.z + quat.w * quat.w);
  shape.unit_quat = {quat.x * shape.inverse_length, quat.y * shape.inverse_length, quat.z * shape.inverse_length,
                     quat.w * shape.inverse_length};
  shape.rotation = rotation_matrix(shape.unit_quat);
  shape.scales = {exp(log_scales.x), exp(log_scales.y), exp(log_scales.z)};
  for (int row = 0; row < 3; ++row) {
    shape.factor(row, 0) = shape.rotation(row, 0) * shape.scales.x;
    shape.factor(row, 1) = shape.rotation(row, 1) * shape.scales.y;
    shape.factor(row, 2) = shape.rotation(row, 2) * shape.scales.z;
  }
  return shape;
}

/// Gradient with respect to the stored parameters.
template <class Real>
struct ShapeGrad {
  Vec3<Real> log_scales;
  Vec4<Real> quat;  // orthogonal to the stored quaternion, which is not normalised
};

/// Computes the gradients of the stored log scales and quaternion from the gradient with respect to M.
template <class Real>
B3DGS_HD ShapeGrad<Real> shape_backward(const Shape<Real>& shape, const Mat3<Real>& grad_factor) {
  const Mat3<Real>& g = grad_factor;
  const Mat3<Real>& m = shape.factor;
  ShapeGrad<Real> grad;
  // dL/ds_j = sum_i g_ij R_ij, and d s_j / d log s_j = s_j turns R into M.
  grad.log_scales = {g(0, 0) * m(0, 0) + g(1, 0) * m(1, 0) + g(2, 0) * m(2, 0),
                     g(0, 1) * m(0, 1) + g(1, 1) * m(1, 1) + g(2, 1) * m(2, 1),
                     g(0, 2) * m(0, 2) + g(1, 2) * m(1, 2) + g(2, 2) * m(2, 2)};

  const Vec3<Real> s = shape.scales;
  const Real r00 = g(0, 0) * s.x, r01 = g(0, 1) * s.y, r02 = g(0, 2) * s.z;
  const Real r10 = g(1, 0) * s.x, r11 = g(1, 1) * s.y, r12 = g(1, 2) * s.z;
  const Real r20 = g(2, 0) * s.x, r21 = g(2, 1) * s.y, r22 = g(2, 2) * s.z;
  const Real w = shape.unit_quat.x, x = shape.unit_quat.y, y = shape.unit_quat.z, z = shape.unit_quat.w;
  const Real gw = 2 * (-z * r01 + y * r02 + z * r10 - x * r12 - y * r20 + x * r21);
  const Real gx = 2 * (y * r01 + z * r02 + y * r10 - 2 * x * r11 - w * r12 + z * r20 + w * r21 - 2 * x * r22);
  const Real gy = 2 * (-2 * y * r00 + x * r01 + w * r02 + x * r10 + z * r12 - w * r20 + z * r21 - 2 * y * r22);
  const Real gz = 2 * (-2 * z * r00 - w * r01 + x * r02 + w * r10 - 2 * z * r11 + y * r12 + x * r20 + y * r21);
  // Backward through the normalisation. The component along the quaternion changes only its length.
  const Real along = gw * w + gx * x + gy * y + gz * z;
  const Real k = shape.inverse_length;
  grad.quat = {(gw - along * w) * k, (gx - along * x) * k, (gy - along * y) * k, (gz - along * z) * k};
  return grad;
}

}  // namespace b3dgs
