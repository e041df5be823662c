// Lenses other than the pinhole: the pixel of a point, its Jacobian, and products with its Hessians. Fisheyes and
// panoramas also see points beside and behind the camera.
//
// A lens is a base projection (x, y, z) -> (a, b), then planar distortion (a, b) -> (D1, D2), then focal lengths and
// principal point. The bases are tangent (x/z, y/z), equidistant (theta/rho (x, y), theta the angle to the axis), and
// equirectangular (longitude, latitude; focal lengths width/2pi and height/pi). Projection and gradient need
//   the pixel, the rows J_x and J_y of the Jacobian, and H_x f + H_y g, with H_x and H_y the Hessians of the pixel.
#pragma once

#include <cmath>

#include "core/vec.h"
#include "raster/view_lens.h"

namespace b3dgs {

/// Stands for the pinhole, whose projection is in projection.h. Kernels have an instance for it, and another for all
/// other lenses.
struct Pinhole {};

/// Calls visit(Pinhole) or visit(lens), and returns the result.
template <class Real, class Visit>
auto with_lens(const LensParams<Real>& lens, Visit&& visit) {
  return lens.kind == LensKind::kPinhole ? visit(Pinhole{}) : visit(lens);
}

// Largest latitude (degrees) at which the Jacobian of a panorama is evaluated. Towards the poles it is unbounded.
inline constexpr double kMaxLatitude = 86;
// A fisheye does not see a Gaussian whose centre is farther beyond max_angle than this (rad).
inline constexpr double kAngleMargin = 0.35;
// If the largest standard deviation of a Gaussian exceeds this fraction of its distance, a lens with radial depth draws
// it as if it were equal to this fraction. Such Gaussians surround the camera, and no affine image resembles theirs. If
// they were skipped, training would never remove them, and pinholes would show them.
inline constexpr double kMaxSpreadOfDistance = 0.5;

/// The point of the base projection, and its gradients with respect to x, y, z.
template <class Real>
struct LensBase {
  Real a, b;
  Vec3<Real> grad_a, grad_b;
};

/// The equidistant projection (S x, S y) with S = theta / rho, and the terms of its derivatives.
template <class Real>
struct Equidistant {
  Real s;          // S
  Real p, q;       // (dS/drho) / rho, dS/dz
  Real pp, qq, r;  // (dp/drho) / rho, (dq/drho) / rho, dq/dz
};

template <class Real>
B3DGS_HD Equidistant<Real> equidistant(const Vec3<Real>& c) {
  using std::atan2;
  using std::sqrt;
  const Real square = c.x * c.x + c.y * c.y, distance = square + c.z * c.z;
  Equidistant<Real> e;
  e.q = -1 / distance;
  e.qq = 2 / (distance * distance);
  e.r = c.z * e.qq;
  if (c.z > 0 && square < Real(0.01) * c.z * c.z) {
    // Near the axis the closed forms cancel, so use powers of u = (rho / z)^2.
    const Real inverse = 1 / c.z, inverse_square = inverse * inverse, u = square * inverse_square;
    e.s = inverse * (1 + u * (Real(-1) / 3 + u * (Real(1) / 5 + u * (Real(-1) / 7 + u / 9))));
    e.p = inverse * inverse_square *
          (Real(-2) / 3 + u * (Real(4) / 5 + u * (Real(-6) / 7 + u * (Real(8) / 9 - u * Real(10) / 11))));
    e.pp = inverse * inverse_square * inverse_square *
           (Real(8) / 5 + u * (Real(-24) / 7 + u * (Real(48) / 9 + u * (Real(-80) / 11 + u * Real(120) / 13))));
  } else {
    const Real rho = sqrt(square);
    e.s = atan2(rho, c.z) / rho;
    e.p = (c.z / distance - e.s) / square;
    e.pp = (-c.z * e.qq - 3 * e.p) / square;
  }
  return e;
}

template <class Real>
B3DGS_HD LensBase<Real> lens_base(LensKind kind, const Vec3<Real>& c) {
  using std::atan2;
  using std::sqrt;
  if (kind == LensKind::kFisheye) {
    const Equidistant<Real> e = equidistant(c);
    const Real xy = e.p * c.x * c.y;
    return {e.s * c.x, e.s * c.y, {e.s + e.p * c.x * c.x, xy, e.q * c.x}, {xy, e.s + e.p * c.y * c.y, e.q * c.y}};
  }
  if (kind == LensKind::kEquirectangular) {
    const Real square = c.x * c.x + c.z * c.z, h = sqrt(square), distance = square + c.y * c.y;
    const Real k = 1 / (h * distance);
    return {atan2(c.x, c.z),
            atan2(c.y, h),
            {c.z / square, 0, -c.x / square},
            {-c.x * c.y * k, h / distance, -c.z * c.y * k}};
  }
  const Real inverse = 1 / c.z, a = c.x * inverse, b = c.y * inverse;
  return {a, b, {inverse, 0, -a * inverse}, {0, inverse, -b * inverse}};
}

/// Returns (Hessian of a) u + (Hessian of b) v.
template <class Real>
B3DGS_HD Vec3<Real> lens_base_hessian(LensKind kind, const Vec3<Real>& c, const Vec3<Real>& u, const Vec3<Real>& v) {
  using std::sqrt;
  if (kind == LensKind::kFisheye) {
    // In the plane, with c = (x, y), Hess a = p (x I + e_x c^T + c e_x^T) + pp x c c^T. Its column of z is q e_x + qq x
    // c, and zz is r x. Hess b is analogous.
    const Equidistant<Real> e = equidistant(c);
    const Real x = c.x, y = c.y;
    const Real along_u = x * u.x + y * u.y, along_v = x * v.x + y * v.y;
    const Real common_u = e.p * u.x + e.pp * x * along_u + e.qq * x * u.z;
    const Real common_v = e.p * v.y + e.pp * y * along_v + e.qq * y * v.z;
    return {e.p * (x * u.x + along_u) + e.q * u.z + x * common_u + e.p * y * v.x + x * common_v,
            e.p * x * u.y + y * common_u + e.p * (y * v.y + along_v) + e.q * v.z + y * common_v,
            e.q * u.x + e.qq * x * along_u + e.r * x * u.z + e.q * v.y + e.qq * y * along_v + e.r * y * v.z};
  }
  if (kind == LensKind::kEquirectangular) {
    const Real xx = c.x * c.x, zz = c.z * c.z, square = xx + zz, h = sqrt(square), t2 = square + c.y * c.y;
    const Real inverse = 1 / (square * square);
    const Real lxx = -2 * c.x * c.z * inverse, lxz = (xx - zz) * inverse;
    const Real m = 1 / (square * h * t2), n = 1 / (h * t2 * t2);
    const Real pxx = -c.y * (zz * m - 2 * xx * n), pzz = -c.y * (xx * m - 2 * zz * n);
    const Real pxz = c.x * c.y * c.z * (m + 2 * n), pyy = -2 * c.y * square * n;
    const Real k = (c.y * c.y - square) * n, pxy = c.x * k, pyz = c.z * k;
    return {lxx * u.x + lxz * u.z + pxx * v.x + pxy * v.y + pxz * v.z, pxy * v.x + pyy * v.y + pyz * v.z,
            lxz * u.x - lxx * u.z + pxz * v.x + pyz * v.y + pzz * v.z};
  }
  const Real inverse = 1 / c.z, square = inverse * inverse;
  return {-square * u.z, -square * v.z, square * (-u.x - v.y + 2 * inverse * (c.x * u.z + c.y * v.z))};
}

/// The radial factor as a function of s, with its first two derivatives.
template <class Real>
struct RadialFactor {
  Real value, first, second;
};

template <class Real>
B3DGS_HD RadialFactor<Real> radial_factor(const LensParams<Real>& lens, Real s) {
  using std::atan;
  using std::sqrt;
  using std::tan;
  const Real* const k = lens.k;
  if (lens.kind == LensKind::kFov) {
    // atan(x) / x with u = x^2 = m^2 s
    const Real m = 2 * tan(k[0] / 2), u = m * m * s, scale = m / k[0];
    Real value, first, second;
    if (u < Real(0.01)) {
      value = 1 + u * (Real(-1) / 3 + u * (Real(1) / 5 + u * (Real(-1) / 7 + u / 9)));
      first = Real(-1) / 3 + u * (Real(2) / 5 + u * (Real(-3) / 7 + u * (Real(4) / 9 - u * Real(5) / 11)));
      second = Real(2) / 5 + u * (Real(-6) / 7 + u * (Real(12) / 9 + u * (Real(-20) / 11 + u * Real(30) / 13)));
    } else {
      const Real x = sqrt(u), derivative = 1 / (1 + u);
      value = atan(x) / x;
      first = (derivative - value) / (2 * u);
      second = -(derivative * derivative + 3 * first) / (2 * u);
    }
    return {scale * value, scale * m * m * first, scale * m * m * m * m * second};
  }
  if (lens.kind == LensKind::kDivision) {
    const Real q = sqrt(1 - 4 * k[0] * s), inverse = 1 / (1 + q), first = 4 * k[0] * inverse * inverse / q;
    return {2 * inverse, first, 2 * k[0] * first / q * (1 / q + 2 * inverse)};
  }
  if (lens.kind == LensKind::kEucm) {
    const Real root = sqrt(k[1] * s + 1), value = 1 / (k[0] * root + 1 - k[0]), slope = k[0] * k[1] / (2 * root);
    const Real bend = -slope * k[1] / (2 * root * root);
    return {value, -slope * value * value, value * value * (2 * slope * slope * value - bend)};
  }
  const Real n = 1 + s * (k[0] + s * (k[1] + s * (k[2] + s * k[3])));
  const Real n1 = k[0] + s * (2 * k[1] + s * (3 * k[2] + s * 4 * k[3]));
  const Real n2 = 2 * k[1] + s * (6 * k[2] + s * 12 * k[3]);
  const Real inverse = 1 / (1 + s * (k[4] + s * (k[5] + s * k[6])));
  const Real e1 = k[4] + s * (2 * k[5] + s * 3 * k[6]), e2 = 2 * k[5] + s * 6 * k[6];
  const Real value = n * inverse, first = (n1 - value * e1) * inverse;
  return {value, first, (n2 - 2 * first * e1 - value * e2) * inverse};
}

/// The pixel where the lens sees a point, and the rows of the Jacobian.
template <class Real>
struct LensPoint {
  Vec2<Real> pixel;
  Vec3<Real> row_x, row_y;  // px per unit of length
};

/// Focal lengths and principal point, px.
template <class Real>
struct LensScale {
  Real fx, fy, cx, cy;
};

template <class Real>
B3DGS_HD LensPoint<Real> lens_point(const LensParams<Real>& lens, const LensScale<Real>& scale, const Vec3<Real>& c) {
  const LensBase<Real> base = lens_base(lens.kind, c);
  const Real a = base.a, b = base.b, s = a * a + b * b;
  const Real p1 = lens.k[7], p2 = lens.k[8], s1 = lens.k[9], s2 = lens.k[10];
  if (lens.kind == LensKind::kEquirectangular) {
    return {{scale.fx * a + scale.cx, scale.fy * b + scale.cy}, scale.fx * base.grad_a, scale.fy * base.grad_b};
  }
  const RadialFactor<Real> radial = radial_factor(lens, s);
  const Real mixed = 2 * a * b * radial.first + 2 * p1 * a + 2 * p2 * b;
  const Real d1_a = radial.value + 2 * a * a * radial.first + 2 * p1 * b + (6 * p2 + 2 * s1) * a;
  const Real d1_b = mixed + 2 * s1 * b, d2_a = mixed + 2 * s2 * a;
  const Real d2_b = radial.value + 2 * b * b * radial.first + (6 * p1 + 2 * s2) * b + 2 * p2 * a;
  const Real d1 = a * radial.value + 2 * p1 * a * b + p2 * (s + 2 * a * a) + s1 * s;
  const Real d2 = b * radial.value + p1 * (s + 2 * b * b) + 2 * p2 * a * b + s2 * s;
  return {{scale.fx * d1 + scale.cx, scale.fy * d2 + scale.cy},
          (scale.fx * d1_a) * base.grad_a + (scale.fx * d1_b) * base.grad_b,
          (scale.fy * d2_a) * base.grad_a + (scale.fy * d2_b) * base.grad_b};
}

/// Returns H_x f + H_y g, with H_x and H_y the Hessians of the pixel's coordinates.
template <class Real>
B3DGS_HD Vec3<Real> lens_hessian(const LensParams<Real>& lens, const LensScale<Real>& scale, const Vec3<Real>& c,
                                 const Vec3<Real>& by_x, const Vec3<Real>& by_y) {
  const Vec3<Real> f = scale.fx * by_x, g = scale.fy * by_y;
  if (lens.kind == LensKind::kEquirectangular) return lens_base_hessian(lens.kind, c, f, g);
  const LensBase<Real> base = lens_base(lens.kind, c);
  const Real a = base.a, b = base.b, s = a * a + b * b;
  const Real p1 = lens.k[7], p2 = lens.k[8], s1 = lens.k[9], s2 = lens.k[10];
  const RadialFactor<Real> radial = radial_factor(lens, s);
  const Real mixed = 2 * a * b * radial.first + 2 * p1 * a + 2 * p2 * b;
  const Real d1_a = radial.value + 2 * a * a * radial.first + 2 * p1 * b + (6 * p2 + 2 * s1) * a;
  const Real d1_b = mixed + 2 * s1 * b, d2_a = mixed + 2 * s2 * a;
  const Real d2_b = radial.value + 2 * b * b * radial.first + (6 * p1 + 2 * s2) * b + 2 * p2 * a;

  const Real a_second = 2 * a * radial.first + 4 * a * b * b * radial.second;
  const Real b_second = 2 * b * radial.first + 4 * a * a * b * radial.second;
  const Real d1_aa = 6 * a * radial.first + 4 * a * a * a * radial.second + 6 * p2 + 2 * s1, d1_ab = b_second + 2 * p1;
  const Real d1_bb = a_second + 2 * p2 + 2 * s1, d2_aa = b_second + 2 * p1 + 2 * s2, d2_ab = a_second + 2 * p2;
  const Real d2_bb = 6 * b * radial.first + 4 * b * b * b * radial.second + 6 * p1 + 2 * s2;
  const Real fa = dot(base.grad_a, f), fb = dot(base.grad_b, f), ga = dot(base.grad_a, g), gb = dot(base.grad_b, g);
  return lens_base_hessian(lens.kind, c, d1_a * f + d2_a * g, d1_b * f + d2_b * g) +
         (d1_aa * fa + d1_ab * fb + d2_aa * ga + d2_ab * gb) * base.grad_a +
         (d1_ab * fa + d1_bb * fb + d2_ab * ga + d2_bb * gb) * base.grad_b;
}

/// The point where a Gaussian is linearised. This is its centre or, where the formulas do not hold or grow without
/// bound, the nearest point with the same azimuth (fisheye), depth (perspective lenses) or longitude (panorama).
template <class Real>
struct LensPlace {
  Vec3<Real> at;
  bool is_clamped;
};

template <class Real>
B3DGS_HD LensPlace<Real> lens_place(const LensParams<Real>& lens, const Vec3<Real>& c) {
  using std::atan2;
  using std::cos;
  using std::sin;
  using std::sqrt;
  using std::tan;
  if (lens.kind == LensKind::kEquirectangular) {
    constexpr Real kMax = Real(kMaxLatitude * kDegree);
    const Real h = sqrt(c.x * c.x + c.z * c.z), t = sqrt(h * h + c.y * c.y), y = c.y < 0 ? -c.y : c.y;
    if (y <= h * tan(kMax)) return {c, false};
    const Real scale = h > 0 ? t * cos(kMax) / h : 0;
    const Vec3<Real> at{scale * c.x, c.y < 0 ? -t * sin(kMax) : t * sin(kMax), h > 0 ? scale * c.z : t * cos(kMax)};
    return {at, true};
  }
  const Real rho = sqrt(c.x * c.x + c.y * c.y);
  if (lens.kind == LensKind::kFisheye) {
    if (atan2(rho, c.z) <= lens.max_angle) return {c, false};
    const Real t = sqrt(rho * rho + c.z * c.z), at = t * sin(lens.max_angle);
    if (rho == 0) return {{at, 0, t * cos(lens.max_angle)}, true};  // on the axis, behind the camera
    return {{at / rho * c.x, at / rho * c.y, t * cos(lens.max_angle)}, true};
  }
  const Real limit = c.z * tan(lens.max_angle);
  if (rho <= limit) return {c, false};
  return {{limit / rho * c.x, limit / rho * c.y, c.z}, true};
}

/// Returns the transposed Jacobian of a clamped lens_place() with respect to the point, times v. On the axis of the
/// lens, where the azimuth jumps, only the distance of the point counts.
template <class Real>
B3DGS_HD Vec3<Real> clamped_place_transposed(const LensParams<Real>& lens, const Vec3<Real>& c, const Vec3<Real>& v) {
  using std::cos;
  using std::sin;
  using std::sqrt;
  using std::tan;
  const bool is_panorama = lens.kind == LensKind::kEquirectangular;
  // The linearisation point lies on a cone, at the azimuth of the point. (first, second) is across the axis.
  const Real first = c.x, second = is_panorama ? c.z : c.y;
  const Real v_first = v.x, v_second = is_panorama ? v.z : v.y, v_third = is_panorama ? v.y : v.z;
  const Real rho = sqrt(first * first + second * second), inverse = rho > 0 ? 1 / rho : 0;
  const Real r_first = first * inverse, r_second = second * inverse;
  const Real along = r_first * v_first + r_second * v_second;
  if (!is_panorama && lens.kind != LensKind::kFisheye) {  // (z tan(angle) r, z)
    const Real slope = tan(lens.max_angle), turn = c.z * slope * inverse;
    return {turn * (v_first - r_first * along), turn * (v_second - r_second * along), slope * along + v_third};
  }
  // The linearisation point is t (across r, up), with t the distance of the point.
  constexpr Real kMax = Real(kMaxLatitude * kDegree);
  const Real t = sqrt(dot(c, c)), across = is_panorama ? cos(kMax) : sin(lens.max_angle);
  const Real up = is_panorama ? (c.y < 0 ? -sin(kMax) : sin(kMax)) : cos(lens.max_angle);
  const Real outward = rho > 0 ? along : (is_panorama ? v_second : v_first);  // the direction that lens_place() uses
  const Real radial = (across * outward + up * v_third) / t, turn = t * across * inverse;
  const Vec3<Real> turned{turn * (v_first - r_first * along), is_panorama ? 0 : turn * (v_second - r_second * along),
                          is_panorama ? turn * (v_second - r_second * along) : 0};
  return radial * c + turned;
}

/// Returns the depth of a point, which determines the order of splats and the depth image.
template <class Real>
B3DGS_HD Real lens_depth(const LensParams<Real>& lens, const Vec3<Real>& c) {
  using std::sqrt;
  return has_radial_depth(lens) ? sqrt(dot(c, c)) : c.z;
}

/// Returns the size factor of a Gaussian with this centre and largest standard deviation (kMaxSpreadOfDistance).
template <class Real>
B3DGS_HD Real lens_shrink(const LensParams<Real>& lens, const Vec3<Real>& c, Real sigma) {
  const Real most = Real(kMaxSpreadOfDistance) * lens_depth(lens, c);
  return has_radial_depth(lens) && sigma > most ? most / sigma : 1;
}

/// Returns whether the lens cannot see a Gaussian with this centre, whatever its depth.
template <class Real>
B3DGS_HD bool is_out_of_lens(const LensParams<Real>& lens, const Vec3<Real>& c) {
  using std::atan2;
  using std::sqrt;
  return lens.kind == LensKind::kFisheye &&
         atan2(sqrt(c.x * c.x + c.y * c.y), c.z) > lens.max_angle + Real(kAngleMargin);
}

}  // namespace b3dgs
