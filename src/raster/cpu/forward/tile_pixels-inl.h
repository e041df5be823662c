// Pixel-wise blending: lanes are the pixels of a row. Holds the state of a tile's pixels, blends one splat onto a range
// of rows, and writes the results. Shared by naive, dynamic, shared-memory and segmented.
#if defined(B3DGS_RASTER_CPU_TILE_PIXELS_INL_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef B3DGS_RASTER_CPU_TILE_PIXELS_INL_H_
#undef B3DGS_RASTER_CPU_TILE_PIXELS_INL_H_
#else
#define B3DGS_RASTER_CPU_TILE_PIXELS_INL_H_
#endif

#include <algorithm>

#include "raster/cpu/forward/lanes-inl.h"
// After lanes-inl.h, whose SIMD type they compute on.
#include "raster/cpu/rasterize_cpu.h"
#include "raster/math/blend.h"
#include "raster/math/store_pixel.h"
#include "raster/math/tiling.h"

HWY_BEFORE_NAMESPACE();
namespace b3dgs {
namespace HWY_NAMESPACE {

/// Pixels of one tile as planes. Rows are padded to whole vectors; pixels outside the image count as finished.
struct TilePixels {
  static constexpr int kCapacity = cpu::kMaxTileSide * cpu::kMaxTileSide;
  HWY_ALIGN float transmittance[kCapacity];  // as in PixelState: negated when finished
  HWY_ALIGN float red[kCapacity], green[kCapacity], blue[kCapacity], depth[kCapacity];
  HWY_ALIGN std::int32_t last[kCapacity];

  Rect rect;        // pixels of the tile that are in the image
  int rows;         // number of them
  RowSpan band;     // rows to blend and to write: all, unless begin() is followed by another choice
  int row_vectors;  // SIMD vectors per row
  int stride;       // pixels per row, with padding

  HWY_INLINE void begin(const TileGrid& grid, std::int32_t tile) {
    rect = tile_pixels(grid, tile);
    rows = rect.y_end - rect.y_begin;
    band = {0, rows};
    row_vectors = (grid.tile.width + lane_count() - 1) / lane_count();
    stride = row_vectors * lane_count();
    const int columns = rect.x_end - rect.x_begin;
    for (int row = 0; row < rows; ++row) {
      float* const t = transmittance + row * stride;
      std::fill(t, t + columns, 1.0f);
      std::fill(t + columns, t + stride, kClosedPixel);
    }
    const int n = rows * stride;
    for (float* plane : {red, green, blue, depth}) std::fill(plane, plane + n, 0.0f);
    std::fill(last, last + n, -1);
  }

  /// Smallest range of rows that contains all unfinished pixels of the band; empty if it is done.
  HWY_INLINE void live_rows(int* first, int* end) const {
    *first = rows;
    *end = 0;
    for (int row = band.begin; row < band.end; ++row) {
      bool live = false;
      for (int v = 0; v < row_vectors; ++v) {
        const Lanes t = Lanes::load(transmittance + row * stride + v * lane_count());
        live = live || !none(is_open(t));
      }
      if (!live) continue;
      *first = std::min(*first, row);
      *end = row + 1;
    }
  }

  /// Writes the band's pixels to the image.
  HWY_INLINE void finish(const BlendForwardArgs& args) const {
    for (int row = band.begin; row < band.end; ++row) {
      for (int column = 0; column < rect.x_end - rect.x_begin; ++column) {
        const int p = row * stride + column;
        store_blended(args, rect.x_begin + column, rect.y_begin + row,
                      {red[p], green[p], blue[p], depth[p], magnitude(transmittance[p]), last[p]});
      }
    }
  }
};

/// Blends one splat, at `position` of the tile's list, onto rows [row_begin, row_end).
HWY_INLINE void blend_onto_rows(TilePixels& tile, const Splat& splat, int row_begin, int row_end,
                                std::int32_t position) {
  const SplatShape<Lanes> shape = splat_shape<Lanes>(splat);
  const Lanes red(splat.red), green(splat.green), blue(splat.blue), depth(splat.depth);
  const int lanes = lane_count();
  for (int row = row_begin; row < row_end; ++row) {
    const Lanes pixel_y(static_cast<float>(tile.rect.y_begin + row) + 0.5f);
    for (int v = 0; v < tile.row_vectors; ++v) {
      const Lanes pixel_x = Lanes::iota(static_cast<float>(tile.rect.x_begin + v * lanes) + 0.5f);
      const Footprint<Lanes> footprint = evaluate_footprint(shape, pixel_x, pixel_y);
      if (none(footprint.contributes)) continue;
      const int p = row * tile.stride + v * lanes;
      const Alpha<Lanes> alpha = evaluate_alpha(footprint.power);
      PixelState<Lanes> pixel{Lanes::load(tile.transmittance + p), Lanes::load(tile.red + p),
                              Lanes::load(tile.green + p), Lanes::load(tile.blue + p), Lanes::load(tile.depth + p)};
      const LaneMask accepted = blend_over(pixel, footprint.contributes, alpha.alpha, red, green, blue, depth);
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

/// Pixel-wise blending without staging: splats are read through the list, and every row of the tile evaluates each of
/// them. Checks once per batch whether any pixel is unfinished.
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
