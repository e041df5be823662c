// Real spherical harmonics (SH) up to degree 3, in the order and with the signs of 3DGS. Computes the view-dependent
// colour and its gradients.
#pragma once

#include <cmath>

#include "core/vec.h"
#include "raster/constants.h"

namespace b3dgs {

inline constexpr double kSh0 = 0.28209479177387814;   // sqrt(1 / (4 pi))
inline constexpr double kSh1 = 0.4886025119029199;    // sqrt(3 / (4 pi))
inline constexpr double kSh2a = 1.0925484305920792;   // sqrt(15 / (4 pi))
inline constexpr double kSh2b = 0.31539156525252005;  // sqrt(5 / (16 pi))
inline constexpr double kSh2c = 0.5462742152960396;   // sqrt(15 / (16 pi))
inline constexpr double kSh3a = 0.5900435899266435;   // sqrt(35 / (32 pi))
inline constexpr double kSh3b = 2.890611442640554;    // sqrt(105 / (4 pi))
inline constexpr double kSh3c = 0.4570457994644658;   // sqrt(21 / (32 pi))
inline constexpr double kSh3d = 0.3731763325901154;   // sqrt(7 / (16 pi))
inline constexpr double kSh3e = 1.445305721320277;    // sqrt(105 / (16 pi))

/// Returns the number of floats in a row of shN, the SH coefficients of one Gaussian above degree 0.
B3DGS_HD constexpr int rest_floats(int sh_degree) {
  return 3 * ((sh_degree + 1) * (sh_degree + 1) - 1);
}

/// Writes the (degree + 1)^2 basis values for a unit direction.
template <class Real>
B3DGS_HD void sh_basis(int degree, Vec3<Real> dir, Real* basis) {
  basis[0] = Real(kSh0);
  if (degree < 1) return;
  const Real x = dir.x, y = dir.y, z = dir.z;
  basis[1] = Real(-kSh1) * y;
  basis[2] = Real(kSh1) * z;
  basis[3] = Real(-kSh1) * x;
  if (degree < 2) return;
  const Real xx = x * x, yy = y * y, zz = z * z;
  basis[4] = Real(kSh2a) * x * y;
  basis[5] = Real(-kSh2a) * y * z;
  basis[6] = Real(kSh2b) * (2 * zz - xx - yy);
  basis[7] = Real(-kSh2a) * x * z;
  basis[8] = Real(kSh2c) * (xx - yy);
  if (degree < 3) return;
  basis[9] = Real(-kSh3a) * y * (3 * xx - yy);
  basis[10] = Real(kSh3b) * x * y * z;
  basis[11] = Real(-kSh3c) * y * (4 * zz - xx - yy);
  basis[12] = Real(kSh3d) * z * (2 * zz - 3 * xx - 3 * yy);
  basis[13] = Real(-kSh3c) * x * (4 * zz - xx - yy);
  basis[14] = Real(kSh3e) * z * (xx - yy);
  basis[15] = Real(-kSh3a) * x * (xx - 3 * yy);
}

/// Returns the gradient of sum_k basis_k(dir) w_k with respect to the direction. w_k is the dot product of coefficient
/// k and the gradient with respect to the colour.
template <class Real>
B3DGS_HD Vec3<Real> sh_direction_grad(int degree, Vec3<Real> dir, const Real* w) {
  if (degree < 1) return {0, 0, 0};
  const Real x = dir.x, y = dir.y, z = dir.z;
  Vec3<Real> g{Real(-kSh1) * w[3], Real(-kSh1) * w[1], Real(kSh1) * w[2]};
  if (degree < 2) return g;
  const Real a = Real(kSh2a), b = Real(kSh2b), c = Real(kSh2c);
  g.x += a * (y * w[4] - z * w[7]) - 2 * b * x * w[6] + 2 * c * x * w[8];
  g.y += a * (x * w[4] - z * w[5]) - 2 * b * y * w[6] - 2 * c * y * w[8];
  g.z += a * (-y * w[5] - x * w[7]) + 4 * b * z * w[6];
  if (degree < 3) return g;
  const Real xx = x * x, yy = y * y, zz = z * z, xy = x * y, yz = y * z, xz = x * z;
  const Real k3a = Real(kSh3a), k3b = Real(kSh3b), k3c = Real(kSh3c), k3d = Real(kSh3d), k3e = Real(kSh3e);
  g.x += -6 * k3a * xy * w[9] + k3b * yz * w[10] + 2 * k3c * xy * w[11] - 6 * k3d * xz * w[12] -
         k3c * (4 * zz - 3 * xx - yy) * w[13] + 2 * k3e * xz * w[14] - 3 * k3a * (xx - yy) * w[15];
  g.y += -3 * k3a * (xx - yy) * w[9] + k3b * xz * w[10] - k3c * (4 * zz - xx - 3 * yy) * w[11] - 6 * k3d * yz * w[12] +
         2 * k3c * xy * w[13] - 2 * k3e * yz * w[14] + 6 * k3a * xy * w[15];
  g.z += k3b * xy * w[10] - 8 * k3c * yz * w[11] + 3 * k3d * (2 * zz - xx - yy) * w[12] - 8 * k3c * xz * w[13] +
         k3e * (xx - yy) * w[14];
  return g;
}

/// Colour of one Gaussian.
template <class Real>
struct ShColor {
  Vec3<Real> color;  // 0.5 added, clamped at 0
  unsigned clamped;  // bit c: channel c was clamped
};

/// Returns the colour seen along `offset` = mean - camera centre, of any length except 0. `sh0` has the 3 coefficients
/// of degree 0, and `shN` the others as [k][channel].
template <class Real>
B3DGS_HD ShColor<Real> sh_color(int degree, Vec3<Real> offset, const float* sh0, const float* shN) {
  using std::sqrt;
  Real basis[16];
  sh_basis(degree, (1 / sqrt(dot(offset, offset))) * offset, basis);
  Real color[3];
  for (int c = 0; c < 3; ++c) color[c] = basis[0] * sh0[c] + Real(0.5);
  const int n = (degree + 1) * (degree + 1);
  for (int k = 1; k < n; ++k) {
    // NOLINTNEXTLINE(clang-analyzer-core.UndefinedBinaryOperatorResult): a degree is not negative
    for (int c = 0; c < 3; ++c) color[c] += basis[k] * shN[3 * (k - 1) + c];
  }
  ShColor<Real> result{{0, 0, 0}, 0};
  for (int c = 0; c < 3; ++c) {
    if (color[c] < 0) {
      result.clamped |= 1u << c;
      color[c] *= 0;  // 0, but -infinity becomes NaN, so that it does not turn into black
    }
  }
  result.color = {color[0], color[1], color[2]};
  return result;
}

/// Computes the gradients of the coefficients above degree 0, [k][channel], for a colour seen along the unit vector
/// `dir`.
template <class Real>
B3DGS_HD void sh_rest_grad(int degree, Vec3<Real> dir, Vec3<Real> grad_color, float* grad_shN) {
  Real basis[16]{};  // initialised because GCC does not see that sh_basis() writes every value read below
  sh_basis(degree, dir, basis);
  const Real grad[3] = {grad_color.x, grad_color.y, grad_color.z};
  const int n = (degree + 1) * (degree + 1);
  for (int k = 1; k < n; ++k) {
    for (int c = 0; c < 3; ++c) grad_shN[3 * (k - 1) + c] = float(basis[k] * grad[c]);
  }
}

/// Viewing direction and the gradient through it.
template <class Real>
struct ShOffsetGrad {
  Vec3<Real> dir;     // unit vector along the offset
  Vec3<Real> offset;  // gradient of the loss with respect to the offset
};

/// `grad_color` must be 0 in channels that were clamped.
template <class Real>
B3DGS_HD ShOffsetGrad<Real> sh_offset_grad(int degree, Vec3<Real> offset, const float* shN, Vec3<Real> grad_color) {
  using std::sqrt;
  const Real inverse_length = 1 / sqrt(dot(offset, offset));
  const Vec3<Real> dir = inverse_length * offset;
  const int n = (degree + 1) * (degree + 1);
  Real weight[16];
  for (int k = 1; k < n; ++k) {
    const float* const row = shN + 3 * (k - 1);
    weight[k] = row[0] * grad_color.x + row[1] * grad_color.y + row[2] * grad_color.z;
  }
  const Vec3<Real> grad_dir = sh_direction_grad(degree, dir, weight);
  return {dir, inverse_length * (grad_dir - dot(grad_dir, dir) * dir)};
}

/// Returns whether a splat's colour (already clamped at 0) is finite and within the limit in constants.h.
B3DGS_HD bool is_usable_color(float red, float green, float blue) {
  return red <= kColorMax && green <= kColorMax && blue <= kColorMax;  // false for NaN
}

}  // namespace b3dgs
