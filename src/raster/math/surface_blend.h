// The surface of a pixel: what a splat adds to depth, normal and confidence. As in blend.h, `Real` may be a SIMD
// vector, and SIMD sources include this header once per instruction set, after blend.h.
#include "raster/geometry.h"
#include "raster/math/blend.h"
#include "raster/math/plane.h"

#if defined(B3DGS_RASTER_SURFACE_BLEND_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef B3DGS_RASTER_SURFACE_BLEND_H_
#undef B3DGS_RASTER_SURFACE_BLEND_H_
#else
#define B3DGS_RASTER_SURFACE_BLEND_H_
#endif

#if defined(HWY_NAMESPACE)
HWY_BEFORE_NAMESPACE();
namespace b3dgs {
namespace HWY_NAMESPACE {
#define B3DGS_BLEND_FN HWY_INLINE
#else
namespace b3dgs {
#define B3DGS_BLEND_FN B3DGS_HD
#endif

/// A pixel while its surface is blended, front to back. Sums of values are relative to `first`, so that their spread
/// does not cancel.
template <class Real>
struct SurfacePixel {
  Real transmittance;                 // as in PixelState
  Real first;                         // value of the first splat with a share
  Real share;                         // sum of the shares of splats in the depth
  Real offset, square;                // sums of share times (value - first), and times its square
  Real variance;                      // sum of share times PlaneRow::variance
  Real normal_x, normal_y, normal_z;  // sum of blend weight times normal
};

/// Returns how much a splat determines the depth of the pixel. It takes the transmittance from `before` to `after`.
template <class Real>
B3DGS_BLEND_FN Real depth_share(DepthKind kind, Real before, Real after) {
  const Real zero(0.0f);
  if (kind == DepthKind::kMedian) {
    const Real half(kSurfaceTransmittance);
    return select((before >= half) & (after < half), Real(1.0f), zero);
  }
  const Real low(kind == DepthKind::kSurface ? kSurfaceBandLow : 0.0f);
  const Real high(kind == DepthKind::kSurface ? kSurfaceBandHigh : 1.0f);
  const Real overlap = select(before < high, before, high) - select(after > low, after, low);
  return select(overlap > zero, overlap, zero);
}

/// Blends a splat where it contributes, as blend_over() does. (dx, dy): pixel centre minus mean, px.
template <class Real>
B3DGS_BLEND_FN void blend_surface(SurfacePixel<Real>& pixel, DepthKind kind, const PlaneRow& plane,
                                  Mask<Real> contributes, Real alpha, Real dx, Real dy) {
  const Real before = magnitude(pixel.transmittance);
  const Real weight = blend_weight_over(pixel.transmittance, contributes, alpha);
  const Real share = depth_share(kind, before, magnitude(pixel.transmittance));

  // Far from the centre, the plane is not that of the splat's peaks. The depth of the centre replaces it.
  const Real at_center(plane.value);
  const Real tilted = multiply_add(Real(plane.slope_x), dx, multiply_add(Real(plane.slope_y), dy, at_center));
  const Mask<Real> is_close =
      (tilted >= Real(plane.value * (1 / (1 + kPlaneReach)))) & (Real(plane.value * (1 / (1 - kPlaneReach))) >= tilted);
  const Real value = select(is_close, tilted, at_center);

  pixel.first = select(pixel.share > Real(0.0f), pixel.first, value);
  const Real offset = value - pixel.first, part = share * offset;
  pixel.share = pixel.share + share;
  pixel.offset = pixel.offset + part;
  pixel.square = multiply_add(part, offset, pixel.square);
  pixel.variance = multiply_add(share, Real(plane.variance), pixel.variance);
  pixel.normal_x = multiply_add(weight, Real(plane.normal.x), pixel.normal_x);
  pixel.normal_y = multiply_add(weight, Real(plane.normal.y), pixel.normal_y);
  pixel.normal_z = multiply_add(weight, Real(plane.normal.z), pixel.normal_z);
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
