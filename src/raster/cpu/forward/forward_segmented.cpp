// Forward blend, segmented: shared-memory, with the tiles of long lists cut so that threads finish at about the same
// time even if one tile holds most of the work. A GPU cuts the list; on a CPU it is the tile that is cut, into bands of
// rows: a pixel's sums keep their order, and the image is that of shared-memory bit for bit. Kernels are chosen by
// timing, so only equal images make equal commands give equal models.
//   Threads: take tasks from an atomic counter: bands of tiles with long lists first, then whole tiles.
//   Lanes, staging and row culling: those of shared-memory. Each band stages the list again, which costs little
//     compared to blending, and ends with its own pixels.

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "raster/cpu/forward/forward_segmented.cpp"
#include <hwy/foreach_target.h>
// Everything below is compiled once per instruction set.
#include "raster/cpu/forward/staged_splats-inl.h"

#include <vector>

#include "core/parallel.h"
#include "raster/cpu/forward/forward_table.h"

#ifndef B3DGS_RASTER_CPU_BAND_
#define B3DGS_RASTER_CPU_BAND_
namespace b3dgs::cpu {

/// Pixel rows of a tile.
struct Band {
  std::int64_t tile;
  RowSpan rows;
};

}  // namespace b3dgs::cpu
#endif

HWY_BEFORE_NAMESPACE();
namespace b3dgs {
namespace HWY_NAMESPACE {

void run_forward_segmented(const BlendForwardArgs& args, const cpu::Band& band) {
  TilePixels tile;
  tile.begin(args.grid, static_cast<std::int32_t>(band.tile));
  tile.band = band.rows;
  blend_staged(args, band.tile, tile);
  tile.finish(args);
}

}  // namespace HWY_NAMESPACE
}  // namespace b3dgs
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace b3dgs {
HWY_EXPORT(run_forward_segmented);

namespace cpu {

void blend_forward_segmented(const BlendForwardArgs& args) {
  // List entries per task: about a millisecond of work on a crowded tile, long compared to the overhead of a task.
  constexpr std::int64_t kEntries = 4096;
  std::vector<Band> bands, whole_tiles;
  for (std::int64_t tile = 0; tile < args.grid.n_tiles(); ++tile) {
    const std::int64_t n = args.bins.tile_offsets[tile + 1] - args.bins.tile_offsets[tile];
    const Rect rect = tile_pixels(args.grid, static_cast<std::int32_t>(tile));
    const std::int32_t rows = rect.y_end - rect.y_begin;
    const auto count = static_cast<std::int32_t>(std::min<std::int64_t>(rows, (n + kEntries - 1) / kEntries));
    if (count <= 1) {
      whole_tiles.push_back({tile, {0, rows}});
      continue;
    }
    for (std::int32_t k = 0; k < count; ++k) bands.push_back({tile, {rows * k / count, rows * (k + 1) / count}});
  }
  bands.insert(bands.end(), whole_tiles.begin(), whole_tiles.end());
  parallel_pool(static_cast<std::int64_t>(bands.size()), [&](std::int64_t task, int) {
    HWY_DYNAMIC_DISPATCH(run_forward_segmented)(args, bands[static_cast<std::size_t>(task)]);
  });
}

}  // namespace cpu
}  // namespace b3dgs
#endif
