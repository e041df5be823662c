// Forward blend, Gaussian-wise.
//   Threads: each gets an equal, contiguous share of the tiles before it starts.
//   Lanes: consecutive splats of the list (a group); pixels are blended one after the other.
//   Per group: gather the splats, evaluate them at the pixel, prefix product of 1 - alpha (splat_groups-inl.h).
//   Ends: a pixel stops after the group that finishes it, so no lane waits for another pixel.
//   Cost: a prefix product per group, and splats are fetched again for every pixel. On a CPU this is faster than
//     pixel-wise blending only where few pixels of a tile are unfinished.

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "raster/cpu/forward/forward_gaussian_wise.cpp"
#include <hwy/foreach_target.h>
// Everything below is compiled once per instruction set.
#include "raster/cpu/forward/splat_groups-inl.h"

#include "core/parallel.h"
#include "raster/cpu/forward/forward_table.h"
#include "raster/math/tiling.h"

HWY_BEFORE_NAMESPACE();
namespace b3dgs {
namespace HWY_NAMESPACE {

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

}  // namespace HWY_NAMESPACE
}  // namespace b3dgs
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace b3dgs {
HWY_EXPORT(run_forward_gaussian_wise);

namespace cpu {

void blend_forward_gaussian_wise(const BlendForwardArgs& args) {
  parallel_chunks(args.grid.n_tiles(), 1, [&](std::int64_t begin, std::int64_t end) {
    HWY_DYNAMIC_DISPATCH(run_forward_gaussian_wise)(args, begin, end);
  });
}

}  // namespace cpu
}  // namespace b3dgs
#endif
