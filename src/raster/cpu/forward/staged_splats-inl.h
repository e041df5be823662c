// Staged blending: a batch of splats is copied side by side into the first-level cache, each with the rows of the tile
// that it reaches, so that rows outside them skip it. Shared by shared-memory and segmented.
#if defined(B3DGS_RASTER_CPU_STAGED_SPLATS_INL_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef B3DGS_RASTER_CPU_STAGED_SPLATS_INL_H_
#undef B3DGS_RASTER_CPU_STAGED_SPLATS_INL_H_
#else
#define B3DGS_RASTER_CPU_STAGED_SPLATS_INL_H_
#endif

#include <algorithm>

#include "raster/cpu/forward/tile_pixels-inl.h"

HWY_BEFORE_NAMESPACE();
namespace b3dgs {
namespace HWY_NAMESPACE {

/// Blends the list of tile `index` onto the unfinished pixels of its band.
HWY_INLINE void blend_staged(const BlendForwardArgs& args, std::int64_t index, TilePixels& tile) {
  constexpr int kBatch = 32;  // about 2 KiB; unfinished rows are determined once per batch
  struct Staged {
    Splat splat;
    RowSpan rows;
    std::int32_t position;
  };
  Staged staged[kBatch];
  const float top = static_cast<float>(tile.rect.y_begin);
  const std::int32_t* const list = args.bins.splat_ids + args.bins.tile_offsets[index];
  const std::int64_t end = args.bins.tile_offsets[index + 1] - args.bins.tile_offsets[index];
  for (std::int64_t batch = 0; batch < end; batch += kBatch) {
    int live_begin, live_end;
    tile.live_rows(&live_begin, &live_end);
    if (live_begin >= live_end) break;

    int n_staged = 0;
    for (std::int64_t i = batch; i < std::min<std::int64_t>(batch + kBatch, end); ++i) {
      const std::int32_t id = list[i];
      Staged& next = staged[n_staged];
      next.splat = args.splats[id];
      next.rows = rows_reached(next.splat.mean_y, args.extents[id].y, top, live_begin, live_end);
      next.position = static_cast<std::int32_t>(i);
      n_staged += next.rows.begin < next.rows.end;
    }
    for (int s = 0; s < n_staged; ++s) {
      blend_onto_rows(tile, staged[s].splat, staged[s].rows.begin, staged[s].rows.end, staged[s].position);
    }
  }
}

}  // namespace HWY_NAMESPACE
}  // namespace b3dgs
HWY_AFTER_NAMESPACE();

#endif  // per-target guard
