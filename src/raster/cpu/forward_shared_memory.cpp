// Forward blend, shared-memory: lanes over pixels, tiles from the pool, splats staged in batches: packed side by side
// in the first-level cache together with the rows of the tile that each can reach, so that no lane looks at a splat
// that ends above or below it. The fastest schedule on a CPU, where a core has no idle lanes that Gaussian-wise work
// could fill.

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "raster/cpu/forward_shared_memory.cpp"
#include <hwy/foreach_target.h>
// Once per target from here.
#include "raster/cpu/tile_pixels-inl.h"

#include "parallel.h"
#include "raster/cpu/forward_table.h"

HWY_BEFORE_NAMESPACE();
namespace b3dgs {
namespace HWY_NAMESPACE {

void run_forward_shared_memory(const BlendForwardArgs& args, std::int64_t task) {
  constexpr int kBatch = 32;
  struct Staged {
    Splat splat;
    std::int32_t row_begin, row_end, position;
  };
  Staged staged[kBatch];
  TilePixels tile;
  tile.begin(args.grid, static_cast<std::int32_t>(task));
  const float top = static_cast<float>(tile.rect.y_begin);
  const std::int64_t first = args.bins.tile_offsets[task], last = args.bins.tile_offsets[task + 1];
  for (std::int64_t batch = first; batch < last; batch += kBatch) {
    int live_begin, live_end;
    tile.live_rows(&live_begin, &live_end);
    if (live_begin >= live_end) break;

    int n_staged = 0;
    for (std::int64_t i = batch; i < std::min<std::int64_t>(batch + kBatch, last); ++i) {
      const std::int32_t id = args.bins.splat_ids[i];
      Staged& next = staged[n_staged];
      next.splat = args.splats[id];
      const float middle = next.splat.mean_y - top - 0.5f, reach = args.extents[id].y;
      next.row_begin = detail::floor_clamped(middle - reach, live_begin - 1, live_end) + 1;
      next.row_end = detail::floor_clamped(middle + reach, live_begin - 1, live_end - 1) + 1;
      next.position = static_cast<std::int32_t>(i - first);
      n_staged += next.row_begin < next.row_end;
    }
    for (int s = 0; s < n_staged; ++s) {
      blend_onto_rows(tile, staged[s].splat, staged[s].row_begin, staged[s].row_end, staged[s].position);
    }
  }
  tile.finish(args);
}

}  // namespace HWY_NAMESPACE
}  // namespace b3dgs
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace b3dgs {
HWY_EXPORT(run_forward_shared_memory);

namespace cpu {

void blend_forward_shared_memory(const BlendForwardArgs& args) {
  parallel_pool(args.grid.n_tiles(), [&](std::int64_t tile, int) {
    HWY_DYNAMIC_DISPATCH(run_forward_shared_memory)(args, tile);
  });
}

}  // namespace cpu
}  // namespace b3dgs
#endif
