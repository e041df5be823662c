// Forward blend, combined (the paper's fine-grained combined load balancing).
//   Threads: take tasks of 2 x 2 pixels (quads) from an atomic counter. A crowded tile becomes tens of tasks, and
//     threads finish at about the same time even if one tile holds most of the work.
//   Lanes: consecutive splats of the list (a group). A group is fetched once for the four pixels of the task.
//   Per group and pixel: evaluate the splats, prefix product of 1 - alpha (splat_groups-inl.h).
//   Ends: a task stops after the group that finishes the last of its pixels.

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "raster/cpu/forward/forward_combined.cpp"
#include <hwy/foreach_target.h>
// Everything below is compiled once per instruction set.
#include "raster/cpu/forward/splat_groups-inl.h"

#include "core/parallel.h"
#include "raster/cpu/forward/forward_table.h"
#include "raster/math/tiling.h"

HWY_BEFORE_NAMESPACE();
namespace b3dgs {
namespace HWY_NAMESPACE {

void run_forward_combined(const BlendForwardArgs& args, std::int64_t task) {
  const TaskPixels pixels = quad_task(args.grid, task);
  const std::int64_t first = args.bins.tile_offsets[pixels.tile], last = args.bins.tile_offsets[pixels.tile + 1];
  PixelScan scans[kQuadPixels];
  const std::int32_t width = pixels.rect.x_end - pixels.rect.x_begin;
  const std::int32_t n_pixels = pixels.rect.empty() ? 0 : width * (pixels.rect.y_end - pixels.rect.y_begin);
  std::int32_t n_live = n_pixels;
  for (std::int64_t i = first; i < last && n_live > 0; i += lane_count()) {
    const SplatGroup group = gather_group(args, first, i, last);
    for (std::int32_t p = 0; p < n_pixels; ++p) {
      if (scans[p].finished) continue;
      const std::int32_t x = pixels.rect.x_begin + p % width, y = pixels.rect.y_begin + p / width;
      blend_group(scans[p], group, static_cast<float>(x) + 0.5f, static_cast<float>(y) + 0.5f);
      n_live -= scans[p].finished;
    }
  }
  for (std::int32_t p = 0; p < n_pixels; ++p) {
    store_pixel(args, scans[p], pixels.rect.x_begin + p % width, pixels.rect.y_begin + p / width);
  }
}

}  // namespace HWY_NAMESPACE
}  // namespace b3dgs
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace b3dgs {
HWY_EXPORT(run_forward_combined);

namespace cpu {

void blend_forward_combined(const BlendForwardArgs& args) {
  parallel_pool(n_quad_tasks(args.grid), [&](std::int64_t task, int) {
    HWY_DYNAMIC_DISPATCH(run_forward_combined)(args, task);
  });
}

}  // namespace cpu
}  // namespace b3dgs
#endif
