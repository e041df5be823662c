// The effect of one splat on one pixel, forward and backward. All kernels, on CPU and GPU, share this arithmetic. It
// has no pointers, loops over splats or thread indices. Kernel files define schedules and call it.
//
// `Real` is float or double for one pixel, or a SIMD vector (cpu/forward/lanes-inl.h) for several pixels or several
// splats at once. Conditions are then masks, and select() replaces branches.
//
// The README of src/raster lists the blending rules.
//
// SIMD sources include this header once per instruction set, inside HWY_NAMESPACE, so that every function is compiled
// for that instruction set. All other sources include it once, and the functions are in namespace b3dgs.
#include "core/vec.h"
#include "raster/constants.h"

#if defined(B3DGS_RASTER_BLEND_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef B3DGS_RASTER_BLEND_H_
#undef B3DGS_RASTER_BLEND_H_
#else
#define B3DGS_RASTER_BLEND_H_
#endif

#include <cmath>
#include <cstdint>

#if defined(HWY_NAMESPACE)
HWY_BEFORE_NAMESPACE();
namespace b3dgs {
namespace HWY_NAMESPACE {
#define B3DGS_BLEND_FN HWY_INLINE
#else
namespace b3dgs {
#define B3DGS_BLEND_FN B3DGS_HD
#endif

/// Type of a condition on Real. SIMD vector types specialise it.
template <class Real>
struct MaskFor;
template <>
struct MaskFor<float> {
  using type = bool;
};
template <>
struct MaskFor<double> {
  using type = bool;
};
template <class Real>
using Mask = typename MaskFor<Real>::type;

// Operations that differ between scalars and vectors.
template <class Real>
B3DGS_BLEND_FN Real select(bool condition, Real if_true, Real if_false) {
  return condition ? if_true : if_false;
}
template <class Real>
B3DGS_BLEND_FN Real multiply_add(Real a, Real b, Real c) {
  return a * b + c;
}
template <class Real>
B3DGS_BLEND_FN Real magnitude(Real a) {
  return a < 0 ? -a : a;
}
template <class Real>
B3DGS_BLEND_FN Real exp2_of(Real a) {
  using std::exp2;
  return exp2(a);
}
template <class Real>
B3DGS_BLEND_FN Real reciprocal_of(Real a) {
  return Real(1.0f) / a;
}
#if defined(__CUDA_ARCH__)
// One instruction each. The error of 2 ulp is far below the tolerance between kernels, and the powers computed here are
// never denormal.
template <>
__device__ __forceinline__ float exp2_of(float a) {
  float result;
  asm("ex2.approx.ftz.f32 %0, %1;" : "=f"(result) : "f"(a));
  return result;
}
template <>
__device__ __forceinline__ float reciprocal_of(float a) {
  float result;
  asm("rcp.approx.ftz.f32 %0, %1;" : "=f"(result) : "f"(a));
  return result;
}
#endif

/// Position and falloff of a splat. Exponents have base 2, as in Splat (args.h).
template <class Real>
struct SplatShape {
  Real mean_x, mean_y;                // px
  Real log2_opacity;                  // <= 0
  Real conic_xx, conic_xy, conic_yy;  // times kConicScale, as in Splat
};

/// `splat` is a Splat (args.h).
template <class Real, class AnySplat>
B3DGS_BLEND_FN SplatShape<Real> splat_shape(const AnySplat& splat) {
  return {Real(splat.mean_x),   Real(splat.mean_y),   Real(splat.log2_opacity),
          Real(splat.conic_xx), Real(splat.conic_xy), Real(splat.conic_yy)};
}

/// The footprint of a splat at a pixel, before the exponential.
template <class Real>
struct Footprint {
  Real conic_delta_x, conic_delta_y;  // conic times delta = pixel centre - mean, 1/px
  Real power;                         // log2 of the uncapped alpha: log2_opacity - delta^T conic delta
  Mask<Real> contributes;             // alpha >= 1/255
};

/// Evaluates a splat at a pixel centre (px). Determines whether it contributes without computing the exponential.
template <class Real>
B3DGS_BLEND_FN Footprint<Real> evaluate_footprint(const SplatShape<Real>& splat, Real pixel_x, Real pixel_y) {
  Footprint<Real> footprint;
  const Real dx = pixel_x - splat.mean_x, dy = pixel_y - splat.mean_y;
  footprint.conic_delta_x = multiply_add(splat.conic_xx, dx, splat.conic_xy * dy);
  footprint.conic_delta_y = multiply_add(splat.conic_xy, dx, splat.conic_yy * dy);
  const Real quadratic = multiply_add(dx, footprint.conic_delta_x, dy * footprint.conic_delta_y);
  footprint.power = splat.log2_opacity - quadratic;
  // The quadratic form can be negative only through rounding. The original rasterizer also skips such splats.
  footprint.contributes = (footprint.power >= Real(kLog2AlphaMin)) & (quadratic >= Real(0.0f));
  return footprint;
}

template <class Real>
struct Alpha {
  Real alpha;         // at most kAlphaMax
  Mask<Real> capped;  // no gradient through alpha
};

/// Returns alpha from its base-2 logarithm, capped.
template <class Real>
B3DGS_BLEND_FN Alpha<Real> evaluate_alpha(Real power) {
  const Real uncapped = exp2_of(power);
  const Mask<Real> capped = uncapped > Real(kAlphaMax);
  return {select(capped, Real(kAlphaMax), uncapped), capped};
}

// The transmittance of a finished pixel is negative. So the test that finishes a pixel also rejects all later splats,
// and kernels need no extra flag.

/// Transmittance of a pixel that takes no splats, because it is outside the image or known to be hidden.
inline constexpr float kClosedPixel = -1.0f;

template <class Real>
B3DGS_BLEND_FN Mask<Real> is_open(Real transmittance) {
  return transmittance > Real(0.0f);
}
template <class Real>
B3DGS_BLEND_FN Mask<Real> is_finished(Real transmittance) {
  return transmittance < Real(0.0f);
}

/// The stop rule: a splat that would leave this transmittance is not blended and finishes the pixel.
template <class Real>
B3DGS_BLEND_FN Mask<Real> is_saturated(Real transmittance) {
  return transmittance < Real(kTransmittanceMin);
}

/// A pixel during blending, front to back.
template <class Real>
struct PixelState {
  Real transmittance;  // (0, 1], negative when finished
  Real red, green, blue;
  Real depth;  // sum of weight times depth
};

/// Blends a splat where it contributes, or finishes the pixel instead. Returns where it was blended.
template <class Real>
B3DGS_BLEND_FN Mask<Real> blend_over(PixelState<Real>& pixel, Mask<Real> contributes, Real alpha, Real red, Real green,
                                     Real blue, Real depth) {
  const Real next = pixel.transmittance * (Real(1.0f) - alpha);
  const Mask<Real> stays_open = next >= Real(kTransmittanceMin);  // !is_saturated(next)
  const Mask<Real> accepted = contributes & stays_open;
  const Mask<Real> finishing = contributes & !stays_open;
  const Real weight = select(accepted, pixel.transmittance * alpha, Real(0.0f));
  pixel.red = multiply_add(weight, red, pixel.red);
  pixel.green = multiply_add(weight, green, pixel.green);
  pixel.blue = multiply_add(weight, blue, pixel.blue);
  pixel.depth = multiply_add(weight, depth, pixel.depth);
  pixel.transmittance =
      select(accepted, next, select(finishing, Real(0.0f) - magnitude(pixel.transmittance), pixel.transmittance));
  return accepted;
}

/// Like blend_over(), but for the transmittance alone. Returns the splat's weight in the pixel, or 0 if not blended.
template <class Real>
B3DGS_BLEND_FN Real blend_weight_over(Real& transmittance, Mask<Real> contributes, Real alpha) {
  const Real zero(0.0f);
  PixelState<Real> pixel{transmittance, zero, zero, zero, zero};
  const Mask<Real> accepted = blend_over(pixel, contributes, alpha, zero, zero, zero, zero);
  const Real weight = select(accepted, transmittance * alpha, zero);
  transmittance = pixel.transmittance;
  return weight;
}

/// Gradients at one pixel for one splat.
template <class Real>
struct BlendGrad {
  Real weight;     // alpha times transmittance: derivative of each pixel channel with respect to the splat's colour
  Real log_alpha;  // dL/d(ln alpha), 0 where alpha is capped
};

// The backward pass visits a pixel's blended splats again, from the last to the first. Let T be the transmittance in
// front of a splat, `value` the dot product of dL/d(pixel colour, depth) with the splat's colour and depth, and
//   S = sum of weight * value over the splats behind it + T_final (dot(dL/dcolour, background) - dL/dalpha_pixel).
// Then
//   dL/dalpha = T value - S / (1 - alpha).
// The pixel's own alpha is 1 - T_final, so its gradient enters S like a background. (Treating it as a value of 1 in
// every splat would compute a difference of nearly equal sums.) S is accumulated back to front. Front to back, it would
// be the total minus the part in front, and the rounding error of the total would dominate where S is small.

/// A pixel whose splats are visited back to front, starting at the end of its list or of any part of the list.
template <class Real>
struct ReverseState {
  Real transmittance;  // behind the next splat to be visited; T_final at the end of the list
  Real behind;         // S
};

/// Steps over one splat. `blended` tells where it was blended.
template <class Real>
B3DGS_BLEND_FN BlendGrad<Real> blend_over_reverse(ReverseState<Real>& pixel, Mask<Real> blended,
                                                  const Alpha<Real>& alpha, Real value) {
  // An alpha of 0 changes nothing: the reciprocal of 1 is exact.
  const Real own = select(blended, alpha.alpha, Real(0.0f));
  const Real inverse = reciprocal_of(Real(1.0f) - own), before = pixel.transmittance * inverse;
  BlendGrad<Real> grad;
  grad.weight = before * own;
  const Real grad_alpha = before * value - pixel.behind * inverse;
  grad.log_alpha = select(alpha.capped, Real(0.0f), grad_alpha * own);
  pixel.behind = multiply_add(grad.weight, value, pixel.behind);
  pixel.transmittance = before;
  return grad;
}

/// Adds the contribution of one pixel to a splat's sums. `Sums` is SplatGrad (args.h), or has the same members as Real.
template <class Sums, class Real>
B3DGS_BLEND_FN void accumulate(Sums& sums, const Footprint<Real>& footprint, const BlendGrad<Real>& grad, Real grad_red,
                               Real grad_green, Real grad_blue, Real grad_depth) {
  const Real mean_x = grad.log_alpha * footprint.conic_delta_x, mean_y = grad.log_alpha * footprint.conic_delta_y;
  sums.log_alpha = sums.log_alpha + grad.log_alpha;
  sums.mean_x = sums.mean_x + mean_x;
  sums.mean_y = sums.mean_y + mean_y;
  sums.cov_xx = multiply_add(mean_x, footprint.conic_delta_x, sums.cov_xx);
  sums.cov_xy = multiply_add(mean_x, footprint.conic_delta_y, sums.cov_xy);
  sums.cov_yy = multiply_add(mean_y, footprint.conic_delta_y, sums.cov_yy);
  sums.red = multiply_add(grad.weight, grad_red, sums.red);
  sums.green = multiply_add(grad.weight, grad_green, sums.green);
  sums.blue = multiply_add(grad.weight, grad_blue, sums.blue);
  sums.depth = multiply_add(grad.weight, grad_depth, sums.depth);
}

/// Counts how many entries of its tile's list a pixel evaluates and blends, front to back.
struct PixelLoad {
  PixelState<float> pixel{1, 0, 0, 0, 0};
  std::int32_t processed = 0;     // entries evaluated, including the one that finishes the pixel
  std::int32_t contributing = 0;  // entries blended
};

/// Counts one entry at a pixel centre (px). Returns false once the pixel is finished.
B3DGS_BLEND_FN bool count_entry(PixelLoad& load, const SplatShape<float>& shape, float center_x, float center_y) {
  ++load.processed;
  const Footprint<float> footprint = evaluate_footprint(shape, center_x, center_y);
  if (!footprint.contributes) return true;
  if (!blend_over(load.pixel, true, evaluate_alpha(footprint.power).alpha, 0.0f, 0.0f, 0.0f, 0.0f)) return false;
  ++load.contributing;
  return true;
}

#undef B3DGS_BLEND_FN
#if defined(HWY_NAMESPACE)
}  // namespace HWY_NAMESPACE
}  // namespace b3dgs
HWY_AFTER_NAMESPACE();
#else
}  // namespace b3dgs
#endif

#endif  // per-target guard
