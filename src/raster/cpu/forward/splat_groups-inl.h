// A group of splats as the lanes, one pixel at a time: Gaussian-wise rendering. Lanes get the transmittance in front of
// them from a prefix product of 1 - alpha; the first that would saturate the pixel ends it. Shared by gaussian-wise and
// combined.
#if defined(B3DGS_RASTER_CPU_SPLAT_GROUPS_INL_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef B3DGS_RASTER_CPU_SPLAT_GROUPS_INL_H_
#undef B3DGS_RASTER_CPU_SPLAT_GROUPS_INL_H_
#else
#define B3DGS_RASTER_CPU_SPLAT_GROUPS_INL_H_
#endif

#include "raster/cpu/forward/lanes-inl.h"
// Highway's order: lanes first, then what computes on them.
#include "raster/args.h"
#include "raster/math/blend.h"

HWY_BEFORE_NAMESPACE();
namespace b3dgs {
namespace HWY_NAMESPACE {

/// Consecutive entries of a tile's list.
struct SplatGroup {
  SplatShape<Lanes> shape;
  Lanes red, green, blue, depth;
  LaneMask present;       // false beyond the end of the list
  std::int32_t position;  // of lane 0 in the list
};

/// One pixel while groups are blended onto it. Colour and depth stay spread over the lanes until the end.
struct PixelScan {
  float transmittance;
  bool finished;
  std::int32_t last;
  Lanes red, green, blue, depth;

  // Written out: the compiler's own constructor would lack the target attributes of this namespace.
  HWY_INLINE PixelScan()
      : transmittance(1), finished(false), last(-1), red(0.0f), green(0.0f), blue(0.0f), depth(0.0f) {}
};

/// Lane i gets the value of lane i - distance, or 1 where there is none.
HWY_INLINE Lanes shift_in_ones(Lanes a, int distance) {
  HWY_ALIGN std::int32_t from[kMaxLanes];
  HWY_ALIGN float shifted_in[kMaxLanes];
  for (int i = 0; i < lane_count(); ++i) {
    from[i] = i < distance ? 0 : i - distance;
    shifted_in[i] = i < distance ? 1.0f : 0.0f;
  }
  const Lanes moved(hn::TableLookupLanes(a.v, hn::SetTableIndices(FloatTag(), from)));
  return select(Lanes::load(shifted_in) > Lanes(0.5f), Lanes(1.0f), moved);
}

/// Product of the lanes up to and including each, in log2(lanes) steps.
HWY_INLINE Lanes prefix_product(Lanes a) {
  for (int distance = 1; distance < lane_count(); distance *= 2) a = a * shift_in_ones(a, distance);
  return a;
}

HWY_INLINE float lane(Lanes a, int index) {
  HWY_ALIGN float lanes[kMaxLanes];
  a.store(lanes);
  return lanes[index];
}

/// Index of the highest lane that is set; some lane is.
HWY_INLINE int last_lane(LaneMask mask) {
  std::uint8_t bits[8] = {};
  hn::StoreMaskBits(FloatTag(), mask.m, bits);
  const unsigned word = bits[0] | static_cast<unsigned>(bits[1]) << 8;
  return 31 - __builtin_clz(word);
}

HWY_INLINE void blend_group(PixelScan& pixel, const SplatGroup& group, float pixel_x, float pixel_y) {
  const Reach<Lanes> reach = evaluate_reach(group.shape, Lanes(pixel_x), Lanes(pixel_y));
  const LaneMask contributes = reach.contributes & group.present;
  if (none(contributes)) return;

  const Alpha<Lanes> alpha = evaluate_alpha(reach.power);
  // A splat that does not contribute lets all light through: it must not enter the product.
  const Lanes passed = prefix_product(select(contributes, Lanes(1.0f) - alpha.alpha, Lanes(1.0f)));
  const Lanes before = Lanes(pixel.transmittance) * shift_in_ones(passed, 1);
  const Lanes after = Lanes(pixel.transmittance) * passed;
  LaneMask accepted = contributes;
  const LaneMask saturating = contributes & (after < Lanes(kTransmittanceMin));
  if (!none(saturating)) {
    const auto stop = static_cast<int>(hn::FindFirstTrue(FloatTag(), saturating.m));
    accepted = accepted & LaneMask{hn::FirstN(FloatTag(), static_cast<std::size_t>(stop))};
    pixel.transmittance = lane(before, stop);
    pixel.finished = true;
  } else {
    pixel.transmittance = lane(after, lane_count() - 1);
  }
  if (none(accepted)) return;
  const Lanes weight = select(accepted, before * alpha.alpha, Lanes(0.0f));
  pixel.red = multiply_add(weight, group.red, pixel.red);
  pixel.green = multiply_add(weight, group.green, pixel.green);
  pixel.blue = multiply_add(weight, group.blue, pixel.blue);
  pixel.depth = multiply_add(weight, group.depth, pixel.depth);
  pixel.last = group.position + last_lane(accepted);
}

HWY_INLINE void store_pixel(const BlendForwardArgs& args, const PixelScan& scan, std::int32_t x, std::int32_t y) {
  const std::int64_t pixel = std::int64_t{y} * args.grid.image_width + x;
  args.out.color[3 * pixel] = scan.red.sum() + scan.transmittance * args.background.x;
  args.out.color[3 * pixel + 1] = scan.green.sum() + scan.transmittance * args.background.y;
  args.out.color[3 * pixel + 2] = scan.blue.sum() + scan.transmittance * args.background.z;
  args.out.depth[pixel] = scan.depth.sum();
  args.out.alpha[pixel] = 1 - scan.transmittance;
  args.transmittance[pixel] = scan.transmittance;
  args.last_ids[pixel] = scan.last;
}

/// Gathers the group that starts at list entry `first`; `last` ends the tile's list, `start` begins it.
HWY_INLINE SplatGroup gather_group(const BlendForwardArgs& args, std::int64_t start, std::int64_t first,
                                   std::int64_t last) {
  const FloatTag d;
  const IntTag di;
  const std::int64_t left = last - first;
  const auto n = static_cast<std::size_t>(left < lane_count() ? left : lane_count());
  HWY_ALIGN std::int32_t ids[kMaxLanes];
  for (int i = 0; i < lane_count(); ++i) ids[i] = args.bins.splat_ids[i < left ? first + i : first];
  // Splat is 12 words long; its fields are addressed as an array of floats.
  constexpr int kWords = sizeof(Splat) / sizeof(float);
  const IntVec base = hn::Mul(hn::Load(di, ids), hn::Set(di, kWords));
  const float* const words = &args.splats->mean_x;
  const auto field = [&](std::int32_t word) {
    return Lanes(hn::GatherIndex(d, words, hn::Add(base, hn::Set(di, word))));
  };
  return {{field(0), field(1), field(2), field(4), field(5), field(6)},
          field(8),
          field(9),
          field(10),
          field(3),
          LaneMask{hn::FirstN(d, n)},
          static_cast<std::int32_t>(first - start)};
}

}  // namespace HWY_NAMESPACE
}  // namespace b3dgs
HWY_AFTER_NAMESPACE();

#endif  // per-target guard
