// Splats staged in batches: packed side by side in the first-level cache together with the rows of the tile that each
// can reach, so that no lane looks at a splat that ends above or below it. Shared by shared-memory and segmented.
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

/// Blends entries [begin, end) of the tile's list onto its pixels, as far as these are not finished.
HWY_INLINE void blend_staged(const BlendForwardArgs& args, std::int64_t index, std::int64_t begin, std::int64_t end,
                             TilePixels& tile) {
  constexpr int kBatch = 32;
  struct Staged {
    Splat splat;
    std::int32_t row_begin, row_end, position;
  };
  Staged staged[kBatch];
  const float top = static_cast<float>(tile.rect.y_begin);
  const std::int32_t* const list = args.bins.splat_ids + args.bins.tile_offsets[index];
  for (std::int64_t batch = begin; batch < end; batch += kBatch) {
    int live_begin, live_end;
    tile.live_rows(&live_begin, &live_end);
    if (live_begin >= live_end) break;

    int n_staged = 0;
    for (std::int64_t i = batch; i < std::min<std::int64_t>(batch + kBatch, end); ++i) {
      const std::int32_t id = list[i];
      Staged& next = staged[n_staged];
      next.splat = args.splats[id];
      const float middle = next.splat.mean_y - top - 0.5f, reach = args.extents[id].y;
      next.row_begin = detail::floor_clamped(middle - reach, live_begin - 1, live_end) + 1;
      next.row_end = detail::floor_clamped(middle + reach, live_begin - 1, live_end - 1) + 1;
      next.position = static_cast<std::int32_t>(i);
      n_staged += next.row_begin < next.row_end;
    }
    for (int s = 0; s < n_staged; ++s) {
      blend_onto_rows(tile, staged[s].splat, staged[s].row_begin, staged[s].row_end, staged[s].position);
    }
  }
}

}  // namespace HWY_NAMESPACE
}  // namespace b3dgs
HWY_AFTER_NAMESPACE();

#endif  // per-target guard
