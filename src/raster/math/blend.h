// What one splat does to one pixel, forward and backward: the arithmetic that every kernel shares. Values in, values
// out; no pointers, no loops over splats, no thread numbers. Kernel files hold schedules and call this.
//
// `Real` is float or double for one pixel, or a SIMD vector (cpu/lanes-inl.h) for several pixels or several splats at
// once; conditions are then masks, and select() takes the place of branches.
//
// Rules: alpha below 1/255 is not blended; alpha is capped at 0.99, and where
// the cap holds no gradient reaches opacity, conic or centre; the splat that would take the transmittance below 1e-4 is
// not blended and finishes the pixel; the background is added with the final transmittance.
//
// SIMD sources compile this header once for each instruction set, inside its namespace, so that every function carries
// the right target attributes; all other sources see it once, in b3dgs.
#include "core/vec.h"
#include "raster/constants.h"

#if defined(B3DGS_RASTER_BLEND_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef B3DGS_RASTER_BLEND_H_
#undef B3DGS_RASTER_BLEND_H_
#else
#define B3DGS_RASTER_BLEND_H_
#endif

#include <cmath>

#if defined(HWY_NAMESPACE)
HWY_BEFORE_NAMESPACE();
namespace b3dgs {
namespace HWY_NAMESPACE {
#define B3DGS_BLEND_FN HWY_INLINE
#else
namespace b3dgs {
#define B3DGS_BLEND_FN B3DGS_HD
#endif

/// Type of a condition on Real; a SIMD vector type specialises it.
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

// The few operations whose form differs between a scalar and a vector.
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
// One instruction each. Its 2 ulp are far below what a kernel may differ by, and the powers here are never denormal.
template <>
__device__ __forceinline__ float exp2_of(float a) {
  float result;
  asm("ex2.approx.ftz.f32 %0, %1;" : "=f"(result) : "f"(a));
  return result;
}
template <>
__device__ __forceinline__ float reciprocal_of(float a) {
  return __fdividef(1.0f, a);
}
#endif

/// Where a splat is and how it falls off; exponents in base 2 as in Splat (args.h).
template <class Real>
struct SplatShape {
  Real mean_x, mean_y;                // px
  Real log2_opacity;                  // <= 0
  Real conic_xx, conic_xy, conic_yy;  // times kConicScale, as in Splat
};

/// A splat as a pixel sees it, up to the exponential.
template <class Real>
struct Reach {
  Real pull_x, pull_y;     // conic d, d = pixel centre - splat centre: half the slope of the exponent, 1/px
  Real power;              // log2 of the uncapped alpha
  Mask<Real> contributes;  // alpha reaches 1/255
};

/// Evaluates a splat at a pixel centre (px). Decides whether it contributes before anyone pays for an exponential.
template <class Real>
B3DGS_BLEND_FN Reach<Real> evaluate_reach(const SplatShape<Real>& splat, Real pixel_x, Real pixel_y) {
  Reach<Real> reach;
  const Real dx = pixel_x - splat.mean_x, dy = pixel_y - splat.mean_y;
  reach.pull_x = multiply_add(splat.conic_xx, dx, splat.conic_xy * dy);
  reach.pull_y = multiply_add(splat.conic_xy, dx, splat.conic_yy * dy);
  const Real quadratic = multiply_add(dx, reach.pull_x, dy * reach.pull_y);
  reach.power = splat.log2_opacity - quadratic;
  // A negative quadratic form can only come from rounding; the original skips it too.
  reach.contributes = (reach.power >= Real(kLog2AlphaMin)) & (quadratic >= Real(0.0f));
  return reach;
}

template <class Real>
struct Alpha {
  Real alpha;         // at most kAlphaMax
  Mask<Real> capped;  // the cap holds: no gradient through alpha
};

/// Opacity times falloff, capped.
template <class Real>
B3DGS_BLEND_FN Alpha<Real> evaluate_alpha(Real power) {
  const Real uncapped = exp2_of(power);
  const Mask<Real> capped = uncapped > Real(kAlphaMax);
  return {select(capped, Real(kAlphaMax), uncapped), capped};
}

/// A pixel while splats are blended onto it, front to back. A finished pixel keeps its transmittance negated, so that
/// it fails every later test without a flag of its own.
template <class Real>
struct PixelState {
  Real transmittance;  // (0, 1], negated when finished
  Real red, green, blue;
  Real depth;  // sum of weight times depth
};

/// Blends a splat where it contributes. Returns where it was blended; where it would have taken the transmittance below
/// kTransmittanceMin, the pixel is finished instead.
template <class Real>
B3DGS_BLEND_FN Mask<Real> blend_over(PixelState<Real>& pixel, Mask<Real> contributes, Real alpha, Real red, Real green,
                                     Real blue, Real depth) {
  const Real next = pixel.transmittance * (Real(1.0f) - alpha);
  const Mask<Real> enough_light = next >= Real(kTransmittanceMin);
  const Mask<Real> accepted = contributes & enough_light;
  const Mask<Real> finishing = contributes & !enough_light;
  const Real weight = select(accepted, pixel.transmittance * alpha, Real(0.0f));
  pixel.red = multiply_add(weight, red, pixel.red);
  pixel.green = multiply_add(weight, green, pixel.green);
  pixel.blue = multiply_add(weight, blue, pixel.blue);
  pixel.depth = multiply_add(weight, depth, pixel.depth);
  pixel.transmittance =
      select(accepted, next, select(finishing, Real(0.0f) - magnitude(pixel.transmittance), pixel.transmittance));
  return accepted;
}

/// One splat's part in the gradient at one pixel.
template <class Real>
struct BlendGrad {
  Real weight;  // alpha times transmittance: gradient of each colour channel by the splat's colour
  Real q;       // dL/d(ln alpha), 0 where the cap holds
};

// The backward pass visits a pixel's splats again, from the last to the first. `value` is the dot product of the
// gradient by the pixel with what the splat shows there, colour and depth. With S = what lies behind the splat, seen
// through the loss,
//   dL/d(alpha) = T value - S / (1 - alpha).
// The pixel's own alpha, 1 - final transmittance, acts like a background that takes light away: it is part of S from
// the start, and of no value. (As a value of 1 for every splat its gradient would be a difference of nearly equal
// sums.) Back to front S is summed and keeps its digits; front to back it would be what is left of the whole, and where
// little light is left the rounding of the whole would show.

/// A pixel while its splats are visited back to front, from the end of its list or of any part of it.
template <class Real>
struct ReverseState {
  Real transmittance;  // behind the next splat to be visited; the final one at the end of the list
  Real behind;  // S; at the end of the list final transmittance times (dot(gradient, background) - gradient by alpha)
};

/// Passes one splat that was blended where `blended` holds.
template <class Real>
B3DGS_BLEND_FN BlendGrad<Real> blend_over_reverse(ReverseState<Real>& pixel, Mask<Real> blended,
                                                  const Alpha<Real>& alpha, Real value) {
  const Real inverse = reciprocal_of(Real(1.0f) - alpha.alpha);
  const Real before = pixel.transmittance * inverse;
  BlendGrad<Real> grad;
  grad.weight = select(blended, before * alpha.alpha, Real(0.0f));
  const Real grad_alpha = before * value - pixel.behind * inverse;
  grad.q = select(blended & !alpha.capped, grad_alpha * alpha.alpha, Real(0.0f));
  pixel.behind = multiply_add(grad.weight, value, pixel.behind);
  pixel.transmittance = select(blended, before, pixel.transmittance);
  return grad;
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
