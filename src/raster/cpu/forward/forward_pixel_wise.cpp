// Forward kernels whose lanes are pixels of a row. A thread corresponds to a thread block of a GPU, and the first-level
// cache to its shared memory.
//   naive: each thread gets an equal, contiguous share of the tiles before it starts. A thread whose share contains
//     the crowded tiles finishes last.
//   dynamic: threads take tiles from an atomic counter (the paper's inter-block dynamic workload distribution). This
//     balances tiles of different cost, but a single tile that costs more than a thread's fair share still determines
//     the time.
//   shared-memory: like naive, but a batch of splats is copied to contiguous memory, and pixels stay in registers while
//     it is blended.
//   sub-tile: threads take tiles from a counter. A vector of pixels blends only the staged splats that reach it.
//   segmented: like sub-tile, but tiles with long lists are cut, so that threads finish at about the same time even if
//     one tile has most of the work. A GPU cuts the list. A CPU cuts the tile into bands of rows, because kernels are
//     chosen by timing and must give the image of sub-tile bit for bit. Each band stages the list again.
// Once per 32 splats, sub-tile and segmented drop rows at the top and bottom of the tile whose pixels are all finished.
// The other kernels check instead whether all pixels of the tile are finished. All kernels store the final
// transmittance and the last splat of each pixel for the backward pass.

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "raster/cpu/forward/forward_pixel_wise.cpp"
#include <hwy/foreach_target.h>
// Everything below is compiled once per instruction set.
#include "raster/cpu/forward/lanes-inl.h"
// Include after lanes-inl.h, because it computes on that SIMD type.
#include "raster/math/blend.h"

#include <algorithm>
#include <vector>

#include "core/parallel.h"
#include "raster/cpu/passes.h"
#include "raster/math/pixel_outputs.h"
#include "raster/math/tiling.h"

HWY_BEFORE_NAMESPACE();
namespace b3dgs {
namespace HWY_NAMESPACE {
namespace {

/// A tile during blending. Pixels outside the image count as finished.
struct TilePixels : TileLayout {
  HWY_ALIGN float transmittance[kCapacity];  // as in PixelState, negative when finished
  HWY_ALIGN float red[kCapacity], green[kCapacity], blue[kCapacity], depth[kCapacity];
  HWY_ALIGN std::int32_t last[kCapacity];

  HWY_INLINE TilePixels(const TileGrid& grid, std::int64_t tile) : TileLayout(grid, tile) {
    for (int row = 0; row < rows; ++row) {
      float* const t = transmittance + row * stride;
      std::fill(t, t + columns, 1.0f);
      std::fill(t + columns, t + stride, kClosedPixel);
    }
    const int n = rows * stride;
    for (float* plane : {red, green, blue, depth}) std::fill(plane, plane + n, 0.0f);
    std::fill(last, last + n, -1);
  }

  /// Returns the smallest range of rows that contains all unfinished pixels of `band`, or an empty one.
  HWY_INLINE Span live_rows(const Span& band) const {
    Span live{rows, 0};
    for (int row = band.begin; row < band.end; ++row) {
      bool is_live = false;
      for (int p = row * stride; p < (row + 1) * stride; p += lane_count()) {
        is_live = is_live || !none(is_open(Lanes::load(transmittance + p)));
      }
      if (is_live) live = {std::min(live.begin, row), row + 1};
    }
    return live;
  }

  /// Writes the rows of `band` to the image.
  HWY_INLINE void finish(const BlendForwardArgs& args, const Span& band) const {
    for (int row = band.begin; row < band.end; ++row) {
      for (int column = 0; column < columns; ++column) {
        const int p = row * stride + column;
        store_blended(args, rect.x_begin + column, rect.y_begin + row,
                      {red[p], green[p], blue[p], depth[p], magnitude(transmittance[p]), last[p]});
      }
    }
  }
};

/// A vector of a tile's pixels, in registers.
struct PixelVector {
  PixelState<Lanes> state;
  IntVec last;

  HWY_INLINE PixelVector(const TilePixels& tile, int p)
      : state{Lanes::load(tile.transmittance + p), Lanes::load(tile.red + p), Lanes::load(tile.green + p),
              Lanes::load(tile.blue + p), Lanes::load(tile.depth + p)},
        last(hn::Load(IntTag(), tile.last + p)) {}
  HWY_INLINE void store(TilePixels& tile, int p) const {
    state.transmittance.store(tile.transmittance + p);
    state.red.store(tile.red + p);
    state.green.store(tile.green + p);
    state.blue.store(tile.blue + p);
    state.depth.store(tile.depth + p);
    hn::Store(last, IntTag(), tile.last + p);
  }
  HWY_INLINE void blend(const Splat& splat, const Footprint<Lanes>& footprint, std::int32_t position) {
    const LaneMask accepted = blend_over(state, footprint.contributes, evaluate_alpha(footprint.power).alpha,
                                         Lanes(splat.red), Lanes(splat.green), Lanes(splat.blue), Lanes(splat.depth));
    last = hn::IfThenElse(hn::RebindMask(IntTag(), accepted.m), hn::Set(IntTag(), position), last);
  }
};

}  // namespace

/// naive and dynamic: reads splats through the list, and every row of the tile evaluates each of them. Checks once per
/// batch whether any pixel is unfinished.
void run_pixel_wise(const BlendForwardArgs& args, std::int64_t index) {
  constexpr std::int64_t kBatch = 32;
  TilePixels tile(args.grid, index);
  const Span band{0, tile.rows};
  const std::int64_t first = args.bins.tile_offsets[index], last = args.bins.tile_offsets[index + 1];
  for (std::int64_t batch = first; batch < last; batch += kBatch) {
    if (tile.live_rows(band).empty()) break;
    for (std::int64_t i = batch; i < std::min(batch + kBatch, last); ++i) {
      const Splat& splat = args.splats[args.bins.splat_ids[i]];
      const auto shape = splat_shape<Lanes>(splat);
      for (int column = 0; column < tile.stride; column += lane_count()) {
        const Lanes pixel_x = tile.center_x(column);
        for (int row = 0; row < tile.rows; ++row) {
          const Footprint<Lanes> footprint = evaluate_footprint(shape, pixel_x, tile.center_y(row));
          if (none(footprint.contributes)) continue;
          const int p = row * tile.stride + column;
          PixelVector pixels(tile, p);
          pixels.blend(splat, footprint, static_cast<std::int32_t>(i - first));
          pixels.store(tile, p);
        }
      }
    }
  }
  tile.finish(args, band);
}

/// shared-memory: keeps a vector of pixels in registers while it evaluates all splats of a batch.
void run_shared_memory(const BlendForwardArgs& args, std::int64_t index) {
  constexpr std::int64_t kBatch = 32;
  TilePixels tile(args.grid, index);
  Splat staged[kBatch];
  const Span band{0, tile.rows};
  const std::int64_t first = args.bins.tile_offsets[index], last = args.bins.tile_offsets[index + 1];
  for (std::int64_t batch = first; batch < last; batch += kBatch) {
    if (tile.live_rows(band).empty()) break;
    const int n = static_cast<int>(std::min(kBatch, last - batch));
    for (int s = 0; s < n; ++s) staged[s] = args.splats[args.bins.splat_ids[batch + s]];
    for (int p = 0; p < tile.rows * tile.stride; p += lane_count()) {
      const Lanes pixel_x = tile.center_x(p % tile.stride), pixel_y = tile.center_y(p / tile.stride);
      PixelVector pixels(tile, p);
      for (int s = 0; s < n; ++s) {
        const Footprint<Lanes> footprint = evaluate_footprint(splat_shape<Lanes>(staged[s]), pixel_x, pixel_y);
        if (none(footprint.contributes)) continue;
        pixels.blend(staged[s], footprint, static_cast<std::int32_t>(batch - first) + s);
      }
      pixels.store(tile, p);
    }
  }
  tile.finish(args, band);
}

/// sub-tile and segmented: like shared-memory, but evaluates only the splats of a batch that reach the vector. Blends
/// and writes only the rows of `band`.
void run_staged(const BlendForwardArgs& args, std::int64_t index, const Span& band) {
  constexpr int kBatch = 32;  // 1.5 KiB, and one bit of a mask per splat
  TilePixels tile(args.grid, index);
  Splat staged[kBatch];
  const std::int32_t* const list = args.bins.splat_ids + args.bins.tile_offsets[index];
  const std::int64_t end = args.bins.tile_offsets[index + 1] - args.bins.tile_offsets[index];
  for (std::int64_t batch = 0; batch < end; batch += kBatch) {
    const Span live = tile.live_rows(band);
    if (live.empty()) break;

    // Rows, and vectors of a row, that each splat reaches. The bit of a splat changes where its range begins and ends.
    std::uint32_t row_changes[cpu::kMaxTileSide + 1] = {}, vector_changes[cpu::kMaxTileSide + 1] = {};
    const int n = static_cast<int>(std::min<std::int64_t>(kBatch, end - batch));
    for (int s = 0; s < n; ++s) {
      const std::int32_t id = list[batch + s];
      staged[s] = args.splats[id];
      const Span rows = tile.rows_reached(staged[s], args.extents[id], live.begin, live.end);
      const Span vectors = tile.vectors_reached(staged[s], args.extents[id]);
      if (rows.empty() || vectors.empty()) continue;
      const std::uint32_t bit = std::uint32_t{1} << s;
      row_changes[rows.begin] ^= bit, row_changes[rows.end] ^= bit;
      vector_changes[vectors.begin] ^= bit, vector_changes[vectors.end] ^= bit;
    }
    // While this batch is blended, the next one is prefetched, a few splats at each row. If all were fetched at once,
    // the fetches would wait for each other.
    std::int64_t ahead = batch + kBatch;
    const std::int64_t ahead_end = std::min(ahead + kBatch, end), per_row = kBatch / (live.end - live.begin) + 1;
    std::uint32_t reach_row = 0;
    for (int row = live.begin; row < live.end; ++row) {
      for (const std::int64_t stop = std::min(ahead + per_row, ahead_end); ahead < stop; ++ahead) {
        cpu::prefetch_object(args.splats[list[ahead]]);
        cpu::prefetch_object(args.extents[list[ahead]]);
      }
      reach_row ^= row_changes[row];
      std::uint32_t reach_vector = 0;
      for (int v = 0; v < tile.row_vectors; ++v) {
        reach_vector ^= vector_changes[v];
        std::uint32_t reaching = reach_row & reach_vector;
        if (reaching == 0) continue;
        const int column = v * lane_count(), p = row * tile.stride + column;
        const Lanes pixel_x = tile.center_x(column), pixel_y = tile.center_y(row);
        PixelVector pixels(tile, p);
        for (; reaching != 0; reaching &= reaching - 1) {
          const int s = __builtin_ctz(reaching);
          const Footprint<Lanes> footprint = evaluate_footprint(splat_shape<Lanes>(staged[s]), pixel_x, pixel_y);
          pixels.blend(staged[s], footprint, static_cast<std::int32_t>(batch) + s);
        }
        pixels.store(tile, p);
      }
    }
  }
  tile.finish(args, band);
}

}  // namespace HWY_NAMESPACE
}  // namespace b3dgs
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace b3dgs {
HWY_EXPORT(run_pixel_wise);
HWY_EXPORT(run_shared_memory);
HWY_EXPORT(run_staged);

namespace cpu {

void blend_forward_naive(const BlendForwardArgs& args) {
  parallel_each(args.grid.n_tiles(), 1, [&](std::int64_t tile) { HWY_DYNAMIC_DISPATCH(run_pixel_wise)(args, tile); });
}

void blend_forward_dynamic(const BlendForwardArgs& args) {
  parallel_pool(args.grid.n_tiles(), [&](std::int64_t tile, int) { HWY_DYNAMIC_DISPATCH(run_pixel_wise)(args, tile); });
}

static int rows_of(const BlendForwardArgs& args, std::int64_t tile) {
  const Rect rect = tile_pixels(args.grid, static_cast<std::int32_t>(tile));
  return rect.y_end - rect.y_begin;
}

void blend_forward_shared_memory(const BlendForwardArgs& args) {
  parallel_each(args.grid.n_tiles(), 1, [&](std::int64_t tile) {
    HWY_DYNAMIC_DISPATCH(run_shared_memory)(args, tile);
  });
}

void blend_forward_sub_tile(const BlendForwardArgs& args) {
  parallel_pool(args.grid.n_tiles(), [&](std::int64_t tile, int) {
    HWY_DYNAMIC_DISPATCH(run_staged)(args, tile, {0, rows_of(args, tile)});
  });
}

/// Takes tasks: first bands of tiles with long lists, then whole tiles.
void blend_forward_segmented(const BlendForwardArgs& args) {
  // Pairs per task. This is about a millisecond of work on a crowded tile, long compared to the overhead of a task.
  constexpr std::int64_t kPairs = 4096;
  struct Band {
    std::int64_t tile;
    Span rows;
  };
  std::vector<Band> bands, whole_tiles;
  for (std::int64_t tile = 0; tile < args.grid.n_tiles(); ++tile) {
    const std::int64_t n = args.bins.tile_offsets[tile + 1] - args.bins.tile_offsets[tile];
    const int rows = rows_of(args, tile);
    const auto count = static_cast<int>(std::clamp<std::int64_t>((n + kPairs - 1) / kPairs, 1, rows));
    std::vector<Band>& tasks = count > 1 ? bands : whole_tiles;
    for (int k = 0; k < count; ++k) tasks.push_back({tile, {rows * k / count, rows * (k + 1) / count}});
  }
  bands.insert(bands.end(), whole_tiles.begin(), whole_tiles.end());
  parallel_pool(static_cast<std::int64_t>(bands.size()), [&](std::int64_t task, int) {
    const Band& band = bands[static_cast<std::size_t>(task)];
    HWY_DYNAMIC_DISPATCH(run_staged)(args, band.tile, band.rows);
  });
}

}  // namespace cpu
}  // namespace b3dgs
#endif
