// The kernels gaussian-wise and combined, whose lanes are consecutive splats of a list (a group). Pixels are blended
// one at a time. The transmittance in front of each lane is a prefix product of 1 - alpha. The first lane that would
// bring it below kTransmittanceMin finishes the pixel.
//   gaussian-wise: each thread gets an equal, contiguous share of the tiles. A pixel stops after the group that
//     finishes it, so no lane waits for another pixel, but splats are loaded again for every pixel. On a CPU this is
//     faster than pixel-wise blending only where few pixels of a tile are unfinished.
//   combined (the paper's fine-grained combined load balancing): threads take tasks of 2 x 2 pixels (quads) from an
//     atomic counter. A crowded tile becomes tens of tasks, so threads finish at about the same time even if one
//     tile has most of the work. A group is loaded once for the four pixels of the task.

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "raster/cpu/forward/forward_gaussian_wise.cpp"
#include <hwy/foreach_target.h>
// Everything below is compiled once per instruction set.
#include "raster/cpu/forward/lanes-inl.h"
// Include after lanes-inl.h, because it computes on that SIMD type.
#include "raster/math/blend.h"

#include <algorithm>
#include <cstddef>

#include "core/parallel.h"
#include "raster/cpu/passes.h"
#include "raster/math/pixel_outputs.h"
#include "raster/math/tiling.h"

HWY_BEFORE_NAMESPACE();
namespace b3dgs {
namespace HWY_NAMESPACE {
namespace {

/// Consecutive entries of a tile's list.
struct SplatGroup {
  SplatShape<Lanes> shape;
  Lanes red, green, blue, depth;
  LaneMask present;       // false past the end of the list
  std::int32_t position;  // position of lane 0 in the list
};

/// A pixel during blending. Colour and depth are partial sums per lane until store_pixel().
struct PixelScan {
  float transmittance;
  bool finished;
  std::int32_t last;
  Lanes red, green, blue, depth;

  // Explicit because a compiler-generated constructor would lack the target attributes of this namespace.
  HWY_INLINE PixelScan()
      : transmittance(1), finished(false), last(-1), red(0.0f), green(0.0f), blue(0.0f), depth(0.0f) {}
};

/// Moves every lane up by `distance` and sets the lowest lanes to 1.
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

/// Returns the inclusive prefix product over the lanes, in log2(lanes) steps.
HWY_INLINE Lanes prefix_product(Lanes a) {
  for (int distance = 1; distance < lane_count(); distance *= 2) a = a * shift_in_ones(a, distance);
  return a;
}

HWY_INLINE float lane(Lanes a, int index) {
  HWY_ALIGN float lanes[kMaxLanes];
  a.store(lanes);
  return lanes[index];
}

/// Returns the index of the highest set lane. At least one lane must be set.
HWY_INLINE int last_lane(LaneMask mask) {
  std::uint8_t bits[8] = {};
  hn::StoreMaskBits(FloatTag(), mask.m, bits);
  const unsigned word = bits[0] | static_cast<unsigned>(bits[1]) << 8;
  return 31 - __builtin_clz(word);
}

/// Blends a group onto the pixel with centre (pixel_x, pixel_y), px.
HWY_INLINE void blend_group(PixelScan& pixel, const SplatGroup& group, float pixel_x, float pixel_y) {
  const Footprint<Lanes> footprint = evaluate_footprint(group.shape, Lanes(pixel_x), Lanes(pixel_y));
  const LaneMask contributes = footprint.contributes & group.present;
  if (none(contributes)) return;

  const Alpha<Lanes> alpha = evaluate_alpha(footprint.power);
  // Splats that do not contribute have a factor of 1.
  const Lanes passed = prefix_product(select(contributes, Lanes(1.0f) - alpha.alpha, Lanes(1.0f)));
  const Lanes before = Lanes(pixel.transmittance) * shift_in_ones(passed, 1);
  const Lanes after = Lanes(pixel.transmittance) * passed;
  LaneMask accepted = contributes;
  const LaneMask saturating = contributes & is_saturated(after);
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

/// Sums the lanes and writes the pixel.
HWY_INLINE void store_pixel(const BlendForwardArgs& args, const PixelScan& scan, std::int32_t x, std::int32_t y) {
  store_blended(args, x, y,
                {scan.red.sum(), scan.green.sum(), scan.blue.sum(), scan.depth.sum(), scan.transmittance, scan.last});
}

/// Gathers the group that begins at list entry `first` of a tile's list [start, last).
HWY_INLINE SplatGroup gather_group(const BlendForwardArgs& args, std::int64_t start, std::int64_t first,
                                   std::int64_t last) {
  const FloatTag d;
  const IntTag di;
  const std::int64_t left = last - first;
  const auto n = static_cast<std::size_t>(left < lane_count() ? left : lane_count());
  HWY_ALIGN std::int32_t ids[kMaxLanes];
  for (int i = 0; i < lane_count(); ++i) ids[i] = args.bins.splat_ids[i < left ? first + i : first];
  // Gathers fields by treating the splats as an array of words.
  constexpr int kWords = sizeof(Splat) / sizeof(float);
  constexpr auto word_of = [](std::size_t offset) { return static_cast<std::int32_t>(offset / sizeof(float)); };
  const IntVec base = hn::Mul(hn::Load(di, ids), hn::Set(di, kWords));
  const float* const words = &args.splats->mean_x;
  const auto field = [&](std::size_t offset) {
    return Lanes(hn::GatherIndex(d, words, hn::Add(base, hn::Set(di, word_of(offset)))));
  };
  return {{field(offsetof(Splat, mean_x)), field(offsetof(Splat, mean_y)), field(offsetof(Splat, log2_opacity)),
           field(offsetof(Splat, conic_xx)), field(offsetof(Splat, conic_xy)), field(offsetof(Splat, conic_yy))},
          field(offsetof(Splat, red)),
          field(offsetof(Splat, green)),
          field(offsetof(Splat, blue)),
          field(offsetof(Splat, depth)),
          LaneMask{hn::FirstN(d, n)},
          static_cast<std::int32_t>(first - start)};
}

}  // namespace

void run_forward_gaussian_wise(const BlendForwardArgs& args, std::int64_t begin, std::int64_t end) {
  for (std::int64_t tile = begin; tile < end; ++tile) {
    const Rect rect = tile_pixels(args.grid, static_cast<std::int32_t>(tile));
    const std::int64_t first = args.bins.tile_offsets[tile], last = args.bins.tile_offsets[tile + 1];
    for (std::int32_t y = rect.y_begin; y < rect.y_end; ++y) {
      for (std::int32_t x = rect.x_begin; x < rect.x_end; ++x) {
        PixelScan pixel;
        for (std::int64_t i = first; i < last && !pixel.finished; i += lane_count()) {
          const SplatGroup group = gather_group(args, first, i, last);
          blend_group(pixel, group, static_cast<float>(x) + 0.5f, static_cast<float>(y) + 0.5f);
        }
        store_pixel(args, pixel, x, y);
      }
    }
  }
}

/// Blends quad q of a tile, counted row by row in `columns`. Skips pixels outside the tile or the image.
void run_forward_combined(const BlendForwardArgs& args, std::int64_t tile, int q, int columns) {
  const Rect rect = tile_pixels(args.grid, static_cast<std::int32_t>(tile));
  const std::int64_t first = args.bins.tile_offsets[tile], last = args.bins.tile_offsets[tile + 1];
  const std::int32_t left = rect.x_begin + q % columns * kQuadSide, top = rect.y_begin + q / columns * kQuadSide;
  const std::int32_t width = std::min(kQuadSide, rect.x_end - left), height = std::min(kQuadSide, rect.y_end - top);
  PixelScan scans[kQuadPixels];
  const std::int32_t n_pixels = width > 0 && height > 0 ? width * height : 0;
  std::int32_t n_live = n_pixels;
  for (std::int64_t i = first; i < last && n_live > 0; i += lane_count()) {
    const SplatGroup group = gather_group(args, first, i, last);
    for (std::int32_t p = 0; p < n_pixels; ++p) {
      if (scans[p].finished) continue;
      const std::int32_t x = left + p % width, y = top + p / width;
      blend_group(scans[p], group, static_cast<float>(x) + 0.5f, static_cast<float>(y) + 0.5f);
      n_live -= scans[p].finished;
    }
  }
  for (std::int32_t p = 0; p < n_pixels; ++p) {
    store_pixel(args, scans[p], left + p % width, top + p / width);
  }
}

}  // namespace HWY_NAMESPACE
}  // namespace b3dgs
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace b3dgs {
HWY_EXPORT(run_forward_gaussian_wise);
HWY_EXPORT(run_forward_combined);

namespace cpu {

void blend_forward_gaussian_wise(const BlendForwardArgs& args) {
  parallel_chunks(args.grid.n_tiles(), 1, [&](std::int64_t begin, std::int64_t end) {
    HWY_DYNAMIC_DISPATCH(run_forward_gaussian_wise)(args, begin, end);
  });
}

void blend_forward_combined(const BlendForwardArgs& args) {
  const int columns = (args.grid.tile.width + kQuadSide - 1) / kQuadSide;
  const int per_tile = columns * ((args.grid.tile.height + kQuadSide - 1) / kQuadSide);
  parallel_pool(std::int64_t{per_tile} * args.grid.n_tiles(), [&](std::int64_t task, int) {
    HWY_DYNAMIC_DISPATCH(run_forward_combined)(args, task / per_tile, static_cast<int>(task % per_tile), columns);
  });
}

}  // namespace cpu
}  // namespace b3dgs
#endif
