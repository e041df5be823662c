// A background that is learned with the scene: its colour at a pixel, and inputs and outputs of the passes that add it
// to a render and differentiate it. Without torch; the same arithmetic on CPU and GPU.
//
// The rasterizer renders on black, and the colour is added with the final transmittance T = 1 - alpha:
//   pixel = render + T colour(direction),   colour_c = sigmoid(sum_k Y_k(direction) coefficient_kc)
// with real spherical harmonics Y of degree 0 (one colour) or 4 and the pixel's viewing direction in the world frame.
// The sigmoid keeps colours within (0, 1), with a gradient everywhere.
#pragma once

#include <cmath>
#include <cstdint>

#include "raster/args.h"
#include "raster/math/array_rows.h"
#include "raster/math/sh.h"
#include "train/optimizer/adam_args.h"

namespace b3dgs {

inline constexpr int kBackgroundDegree = 4;
inline constexpr int kBackgroundCoefficients = (kBackgroundDegree + 1) * (kBackgroundDegree + 1);  // per channel
// Pixels whose gradients are summed as one part; sums of parts are added in order, so that their number of threads does
// not matter.
inline constexpr std::int64_t kBackgroundPart = 4096;

/// All arrays are on one device and contiguous.
struct BackgroundArgs {
  PinholeView view{};
  int degree = 0;                       // 0 or kBackgroundDegree
  const float* coefficients = nullptr;  // [K, 3]
  const float* alpha = nullptr;         // [H, W] of the render
  float* color = nullptr;               // [H, W, 3] in and out
};

/// The gradients of a view's loss, given that with respect to the colours that BackgroundArgs leaves.
struct BackgroundGradArgs {
  PinholeView view{};
  int degree = 0;
  const float* coefficients = nullptr;  // [K, 3]
  const float* alpha = nullptr;         // [H, W]
  const float* grad_color = nullptr;    // [H, W, 3]
  float* grad_alpha = nullptr;          // [H, W] out: what the background adds to the gradient of the render's alpha
  float* parts = nullptr;               // [n_parts, 3 K] scratch
  float* grad_coefficients = nullptr;   // [K, 3] out
};

B3DGS_HD std::int64_t background_parts(const PinholeView& view) {
  return (std::int64_t{view.width} * view.height + kBackgroundPart - 1) / kBackgroundPart;
}

B3DGS_HD constexpr int background_coefficients(int degree) {
  return (degree + 1) * (degree + 1);
}

/// Unit vector, in the world frame, from the camera through the centre of pixel (x, y).
template <class Real>
B3DGS_HD Vec3<Real> pixel_direction(const PinholeView& view, std::int32_t x, std::int32_t y) {
  using std::sqrt;
  Mat3<Real> rotation;
  for (int i = 0; i < 9; ++i) rotation.m[i] = Real(view.rotation.m[i]);
  const Vec3<Real> ray{(Real(x) + Real(0.5) - Real(view.cx)) / Real(view.fx),
                       (Real(y) + Real(0.5) - Real(view.cy)) / Real(view.fy), Real(1)};
  return (Real(1) / sqrt(dot(ray, ray))) * transpose_times(rotation, ray);
}

/// Writes the basis values at a unit direction. Degree 4 follows the order and signs of degrees 1 to 3 (sh.h).
template <int kDegree, class Real>
B3DGS_HD void background_basis(Vec3<Real> dir, Real* basis) {
  static_assert(kDegree == 0 || kDegree == kBackgroundDegree, "one colour, or degree 4");
  sh_basis(kDegree < 3 ? kDegree : 3, dir, basis);
  if constexpr (kDegree == 4) {
    constexpr double k4a = 2.5033429417967046;   // sqrt(315 / (16 pi))
    constexpr double k4b = 1.7701307697799304;   // sqrt(315 / (32 pi))
    constexpr double k4c = 0.9461746957575601;   // sqrt(45 / (16 pi))
    constexpr double k4d = 0.6690465435572892;   // sqrt(45 / (32 pi))
    constexpr double k4e = 0.10578554691520431;  // sqrt(9 / (256 pi))
    constexpr double k4f = 0.4730873478787801;   // sqrt(45 / (64 pi))
    constexpr double k4g = 0.6258357354491761;   // sqrt(315 / (256 pi))
    const Real x = dir.x, y = dir.y, z = dir.z, xx = x * x, yy = y * y, zz = z * z;
    basis[16] = Real(k4a) * x * y * (xx - yy);
    basis[17] = Real(-k4b) * y * z * (3 * xx - yy);
    basis[18] = Real(k4c) * x * y * (7 * zz - 1);
    basis[19] = Real(-k4d) * y * z * (7 * zz - 3);
    basis[20] = Real(k4e) * (zz * (35 * zz - 30) + 3);
    basis[21] = Real(-k4d) * x * z * (7 * zz - 3);
    basis[22] = Real(k4f) * (xx - yy) * (7 * zz - 1);
    basis[23] = Real(-k4b) * x * z * (xx - 3 * yy);
    basis[24] = Real(k4g) * (xx * (xx - 3 * yy) - yy * (3 * xx - yy));
  }
}

/// The colour for basis values; `coefficients` is [K, 3].
template <int kDegree, class Real, class Coefficient>
B3DGS_HD Vec3<Real> background_color(const Real* basis, const Coefficient* coefficients) {
  using std::exp;
  Real sum[3] = {0, 0, 0};
  for (int k = 0; k < background_coefficients(kDegree); ++k) {
    for (int c = 0; c < 3; ++c) sum[c] += basis[k] * Real(coefficients[3 * k + c]);
  }
  return {Real(1) / (Real(1) + exp(-sum[0])), Real(1) / (Real(1) + exp(-sum[1])), Real(1) / (Real(1) + exp(-sum[2]))};
}

/// Adds the background to pixel `p`.
template <int kDegree>
B3DGS_HD void add_background_at(const BackgroundArgs& args, std::int64_t p) {
  float basis[background_coefficients(kDegree)];
  const auto x = static_cast<std::int32_t>(p % args.view.width), y = static_cast<std::int32_t>(p / args.view.width);
  background_basis<kDegree>(pixel_direction<float>(args.view, x, y), basis);
  const Vec3f color = background_color<kDegree>(basis, args.coefficients);
  store3(args.color, p, load3(args.color, p) + (1 - args.alpha[p]) * color);
}

/// Writes the gradient with respect to the alpha of pixel `p`, and adds those with respect to the coefficients to
/// `sums` [3 K].
template <int kDegree>
B3DGS_HD void background_grad_at(const BackgroundGradArgs& args, std::int64_t p, float* sums) {
  constexpr int kCoefficients = background_coefficients(kDegree);
  float basis[kCoefficients];
  const auto x = static_cast<std::int32_t>(p % args.view.width), y = static_cast<std::int32_t>(p / args.view.width);
  background_basis<kDegree>(pixel_direction<float>(args.view, x, y), basis);
  const Vec3f color = background_color<kDegree>(basis, args.coefficients);
  const Vec3f grad = load3(args.grad_color, p);
  args.grad_alpha[p] = -dot(grad, color);
  const float t = 1 - args.alpha[p];
  const float through[3] = {t * grad.x * color.x * (1 - color.x), t * grad.y * color.y * (1 - color.y),
                            t * grad.z * color.z * (1 - color.z)};
#if defined(__CUDA_ARCH__)
#pragma unroll
#endif
  for (int k = 0; k < kCoefficients; ++k) {
    for (int c = 0; c < 3; ++c) sums[3 * k + c] += basis[k] * through[c];
  }
}

}  // namespace b3dgs
