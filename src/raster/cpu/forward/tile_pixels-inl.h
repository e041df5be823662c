// A tile whose pixels are the lanes: state of the pixels, one splat onto a range of its rows, results to the image.
// Shared by the pixel-wise schedules (naive, dynamic, shared-memory).
#if defined(B3DGS_RASTER_CPU_TILE_PIXELS_INL_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef B3DGS_RASTER_CPU_TILE_PIXELS_INL_H_
#undef B3DGS_RASTER_CPU_TILE_PIXELS_INL_H_
#else
#define B3DGS_RASTER_CPU_TILE_PIXELS_INL_H_
#endif

#include <algorithm>

#include "raster/cpu/forward/lanes-inl.h"
// Highway's order: lanes first, then what computes on them.
#include "raster/cpu/rasterize_cpu.h"
#include "raster/math/blend.h"
#include "raster/math/tiling.h"

HWY_BEFORE_NAMESPACE();
namespace b3dgs {
namespace HWY_NAMESPACE {

/// Pixels of one tile, in planes; rows are padded to whole vectors. A pixel outside the image counts as finished.
struct TilePixels {
  static constexpr int kCapacity = cpu::kMaxTileSide * cpu::kMaxTileSide;
  HWY_ALIGN float transmittance[kCapacity];  // as in PixelState: negated when finished
  HWY_ALIGN float red[kCapacity], green[kCapacity], blue[kCapacity], depth[kCapacity];
  HWY_ALIGN std::int32_t last[kCapacity];

  Rect rect;  // of the tile, in the image
  int rows;   // in the image
  int row_vectors;
  int stride;  // of a row, in pixels

  HWY_INLINE void begin(const TileGrid& grid, std::int32_t tile) {
    rect = tile_pixels(grid, tile);
    rows = rect.y_end - rect.y_begin;
    row_vectors = (grid.tile.width + lane_count() - 1) / lane_count();
    stride = row_vectors * lane_count();
    const int columns = rect.x_end - rect.x_begin;
    for (int row = 0; row < rows; ++row) {
      float* const t = transmittance + row * stride;
      std::fill(t, t + columns, 1.0f);
      std::fill(t + columns, t + stride, -1.0f);
    }
    const int n = rows * stride;
    for (float* plane : {red, green, blue, depth}) std::fill(plane, plane + n, 0.0f);
    std::fill(last, last + n, -1);
  }

  /// First and last + 1 row in which a pixel is not finished; empty when the tile is done.
  HWY_INLINE void live_rows(int* first, int* end) const {
    *first = rows;
    *end = 0;
    for (int row = 0; row < rows; ++row) {
      bool live = false;
      for (int v = 0; v < row_vectors; ++v) {
        const Lanes t = Lanes::load(transmittance + row * stride + v * lane_count());
        live = live || !none(t > Lanes(0.0f));
      }
      if (!live) continue;
      *first = std::min(*first, row);
      *end = row + 1;
    }
  }

  HWY_INLINE void finish(const BlendForwardArgs& args) const {
    for (int row = 0; row < rows; ++row) {
      for (int column = 0; column < rect.x_end - rect.x_begin; ++column) {
        const int p = row * stride + column;
        const std::int64_t pixel = std::int64_t{rect.y_begin + row} * args.grid.image_width + rect.x_begin + column;
        const float t = magnitude(transmittance[p]);
        args.out.color[3 * pixel] = red[p] + t * args.background.x;
        args.out.color[3 * pixel + 1] = green[p] + t * args.background.y;
        args.out.color[3 * pixel + 2] = blue[p] + t * args.background.z;
        args.out.depth[pixel] = depth[p];
        args.out.alpha[pixel] = 1 - t;
        args.transmittance[pixel] = t;
        args.last_ids[pixel] = last[p];
      }
    }
  }
};

HWY_INLINE SplatShape<Lanes> broadcast_shape(const Splat& splat) {
  return {Lanes(splat.mean_x),   Lanes(splat.mean_y),   Lanes(splat.log2_opacity),
          Lanes(splat.conic_xx), Lanes(splat.conic_xy), Lanes(splat.conic_yy)};
}

/// Blends one splat, at `position` of the tile's list, onto rows [row_begin, row_end).
HWY_INLINE void blend_onto_rows(TilePixels& tile, const Splat& splat, int row_begin, int row_end,
                                std::int32_t position) {
  const SplatShape<Lanes> shape = broadcast_shape(splat);
  const Lanes red(splat.red), green(splat.green), blue(splat.blue), depth(splat.depth);
  const int lanes = lane_count();
  for (int row = row_begin; row < row_end; ++row) {
    const Lanes pixel_y(static_cast<float>(tile.rect.y_begin + row) + 0.5f);
    for (int v = 0; v < tile.row_vectors; ++v) {
      const Lanes pixel_x = Lanes::iota(static_cast<float>(tile.rect.x_begin + v * lanes) + 0.5f);
      const Reach<Lanes> reach = evaluate_reach(shape, pixel_x, pixel_y);
      if (none(reach.contributes)) continue;
      const int p = row * tile.stride + v * lanes;
      const Alpha<Lanes> alpha = evaluate_alpha(reach.power);
      PixelState<Lanes> pixel{Lanes::load(tile.transmittance + p), Lanes::load(tile.red + p),
                              Lanes::load(tile.green + p), Lanes::load(tile.blue + p), Lanes::load(tile.depth + p)};
      const LaneMask accepted = blend_over(pixel, reach.contributes, alpha.alpha, red, green, blue, depth);
      pixel.transmittance.store(tile.transmittance + p);
      pixel.red.store(tile.red + p);
      pixel.green.store(tile.green + p);
      pixel.blue.store(tile.blue + p);
      pixel.depth.store(tile.depth + p);
      const IntTag di;
      hn::Store(hn::IfThenElse(hn::RebindMask(di, accepted.m), hn::Set(di, position), hn::Load(di, tile.last + p)), di,
                tile.last + p);
    }
  }
}

/// The pixel-wise loop without staging: splats are fetched from global memory through the list, and every row of the
/// tile looks at each. Stops when no pixel is left, asked once per batch.
HWY_INLINE void blend_tile_pixelwise(const BlendForwardArgs& args, TilePixels& tile, std::int64_t index) {
  constexpr std::int64_t kBatch = 32;
  tile.begin(args.grid, static_cast<std::int32_t>(index));
  const std::int64_t first = args.bins.tile_offsets[index], last = args.bins.tile_offsets[index + 1];
  for (std::int64_t batch = first; batch < last; batch += kBatch) {
    int live_begin, live_end;
    tile.live_rows(&live_begin, &live_end);
    if (live_begin >= live_end) break;
    for (std::int64_t i = batch; i < std::min(batch + kBatch, last); ++i) {
      blend_onto_rows(tile, args.splats[args.bins.splat_ids[i]], 0, tile.rows, static_cast<std::int32_t>(i - first));
    }
  }
  tile.finish(args);
}

}  // namespace HWY_NAMESPACE
}  // namespace b3dgs
HWY_AFTER_NAMESPACE();

#endif  // per-target guard
