// SIMD vector type with scalar operators, for blend.h. Included once per instruction set, as Highway requires.
// Everything is in HWY_NAMESPACE.
#if defined(B3DGS_RASTER_CPU_LANES_INL_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef B3DGS_RASTER_CPU_LANES_INL_H_
#undef B3DGS_RASTER_CPU_LANES_INL_H_
#else
#define B3DGS_RASTER_CPU_LANES_INL_H_
#endif

#include <hwy/highway.h>

#include <cstdint>

#include "raster/cpu/passes.h"
#include "raster/math/tiling.h"

HWY_BEFORE_NAMESPACE();
namespace b3dgs {
namespace HWY_NAMESPACE {

namespace hn = hwy::HWY_NAMESPACE;

/// At most 16 lanes, a row of a tile that is 16 px wide.
inline constexpr int kMaxLanes = 16;
using FloatTag = hn::CappedTag<float, kMaxLanes>;
using IntTag = hn::RebindToSigned<FloatTag>;
using FloatVec = hn::Vec<FloatTag>;
using IntVec = hn::Vec<IntTag>;

HWY_INLINE int lane_count() {
  return static_cast<int>(hn::Lanes(FloatTag()));
}

struct LaneMask {
  hn::Mask<FloatTag> m;
  friend HWY_INLINE LaneMask operator&(LaneMask a, LaneMask b) { return {hn::And(a.m, b.m)}; }
  friend HWY_INLINE LaneMask operator!(LaneMask a) { return {hn::Not(a.m)}; }
  friend HWY_INLINE bool none(LaneMask a) { return hn::AllFalse(FloatTag(), a.m); }
};

struct Lanes {
  FloatVec v;

  Lanes() = default;
  HWY_INLINE explicit Lanes(float value) : v(hn::Set(FloatTag(), value)) {}
  HWY_INLINE explicit Lanes(FloatVec value) : v(value) {}

  static HWY_INLINE Lanes load(const float* aligned) { return Lanes(hn::Load(FloatTag(), aligned)); }
  HWY_INLINE void store(float* aligned) const { hn::Store(v, FloatTag(), aligned); }
  /// Returns start, start + 1, ...
  static HWY_INLINE Lanes iota(float start) { return Lanes(hn::Iota(FloatTag(), start)); }
  HWY_INLINE float sum() const { return hn::GetLane(hn::SumOfLanes(FloatTag(), v)); }

  friend HWY_INLINE Lanes operator+(Lanes a, Lanes b) { return Lanes(hn::Add(a.v, b.v)); }
  friend HWY_INLINE Lanes operator-(Lanes a, Lanes b) { return Lanes(hn::Sub(a.v, b.v)); }
  friend HWY_INLINE Lanes operator*(Lanes a, Lanes b) { return Lanes(hn::Mul(a.v, b.v)); }
  friend HWY_INLINE Lanes operator/(Lanes a, Lanes b) { return Lanes(hn::Div(a.v, b.v)); }
  friend HWY_INLINE LaneMask operator>(Lanes a, Lanes b) { return {hn::Gt(a.v, b.v)}; }
  friend HWY_INLINE LaneMask operator>=(Lanes a, Lanes b) { return {hn::Ge(a.v, b.v)}; }
  friend HWY_INLINE LaneMask operator<(Lanes a, Lanes b) { return {hn::Lt(a.v, b.v)}; }
  friend HWY_INLINE Lanes multiply_add(Lanes a, Lanes b, Lanes c) { return Lanes(hn::MulAdd(a.v, b.v, c.v)); }
  friend HWY_INLINE Lanes magnitude(Lanes a) { return Lanes(hn::Abs(a.v)); }
  friend HWY_INLINE Lanes select(LaneMask condition, Lanes if_true, Lanes if_false) {
    return Lanes(hn::IfThenElse(condition.m, if_true.v, if_false.v));
  }
};

/// Returns 2^a with an error of at most 2 ulp for a in [-126, 126]. Blending needs [-8, 0]. Smaller values are clamped,
/// because masks discard their results.
HWY_INLINE Lanes exp2_of(Lanes a) {
  const FloatTag d;
  const FloatVec x = hn::Max(a.v, hn::Set(d, -126.0f));
  // Adding 1.5 * 2^23 rounds to an integer, which is then in the lowest bits of the sum.
  const FloatVec shift = hn::Set(d, 12582912.0f), shifted = hn::Add(x, shift);
  const FloatVec f = hn::Sub(x, hn::Sub(shifted, shift));
  // Polynomial for 2^f on [-0.5, 0.5], interpolated at Chebyshev nodes. Relative error 2.5e-9 before rounding.
  FloatVec p = hn::Set(d, 0.000154614447f);
  p = hn::MulAdd(p, f, hn::Set(d, 0.00134004282f));
  p = hn::MulAdd(p, f, hn::Set(d, 0.00961805668f));
  p = hn::MulAdd(p, f, hn::Set(d, 0.0555032723f));
  p = hn::MulAdd(p, f, hn::Set(d, 0.240226509f));
  p = hn::MulAdd(p, f, hn::Set(d, 0.693147207f));
  p = hn::MulAdd(p, f, hn::Set(d, 1.0f));
  const IntTag di;
  const IntVec exponent = hn::ShiftLeft<23>(hn::BitCast(di, shifted));
  return Lanes(hn::BitCast(d, hn::Add(hn::BitCast(di, p), exponent)));
}

/// Layout of the pixels of a tile in memory: rows padded to whole vectors.
struct TileLayout {
  static constexpr int kCapacity = cpu::kMaxTileSide * cpu::kMaxTileSide;
  Rect rect;          // pixels of the tile inside the image
  int rows, columns;  // size of rect
  int row_vectors;    // SIMD vectors per row
  int stride;         // pixels per row, with padding

  HWY_INLINE TileLayout(const TileGrid& grid, std::int64_t tile)
      : rect(tile_pixels(grid, static_cast<std::int32_t>(tile))),
        rows(rect.y_end - rect.y_begin),
        columns(rect.x_end - rect.x_begin),
        row_vectors((grid.tile.width + lane_count() - 1) / lane_count()),
        stride(row_vectors * lane_count()),
        image_width_(grid.image_width),
        tile_width_(grid.tile.width) {}

  /// Returns the index of a pixel in the image.
  HWY_INLINE std::int64_t pixel(int row, int column) const {
    return std::int64_t{rect.y_begin + row} * image_width_ + rect.x_begin + column;
  }
  HWY_INLINE Lanes center_x(int column) const { return Lanes::iota(static_cast<float>(rect.x_begin + column) + 0.5f); }
  HWY_INLINE Lanes center_y(int row) const { return Lanes(static_cast<float>(rect.y_begin + row) + 0.5f); }

  /// Returns the rows of [begin, end) that have a pixel centre in the box around a splat.
  HWY_INLINE Span rows_reached(const Splat& splat, Vec2f extent, int begin, int end) const {
    return pixels_reached(splat.mean_y, extent.y, static_cast<float>(rect.y_begin), begin, end);
  }
  HWY_INLINE Span vectors_reached(const Splat& splat, Vec2f extent) const {
    const Span reached = pixels_reached(splat.mean_x, extent.x, static_cast<float>(rect.x_begin), 0, tile_width_);
    return {reached.begin / lane_count(), (reached.end + lane_count() - 1) / lane_count()};
  }

 private:
  std::int32_t image_width_, tile_width_;
};

/// Type of a condition on Lanes, used by blend.h.
template <class Real>
struct MaskFor;
template <>
struct MaskFor<Lanes> {
  using type = LaneMask;
};

}  // namespace HWY_NAMESPACE
}  // namespace b3dgs
HWY_AFTER_NAMESPACE();

#endif  // per-target guard
