// Load counting: threads take tiles from an atomic counter and count one pixel at a time. Training calls this only for
// its statistics, so scalar code is fast enough.

#include "core/parallel.h"
#include "raster/cpu/passes.h"
#include "raster/math/pixel_load.h"
#include "raster/math/tiling.h"

namespace b3dgs::cpu {
namespace {

PixelLoad count_pixel(const CountLoadArgs& args, std::int32_t tile, float center_x, float center_y) {
  PixelLoad load;
  for (std::int64_t i = args.bins.tile_offsets[tile]; i < args.bins.tile_offsets[tile + 1]; ++i) {
    const auto shape = splat_shape<float>(args.splats[args.bins.splat_ids[i]]);
    if (!count_entry(load, shape, center_x, center_y)) break;
  }
  return load;
}

}  // namespace

void count_load(const CountLoadArgs& args) {
  parallel_pool(args.grid.n_tiles(), [&](std::int64_t task, int) {
    const auto tile = static_cast<std::int32_t>(task);
    const Rect rect = tile_pixels(args.grid, tile);
    for (std::int32_t y = rect.y_begin; y < rect.y_end; ++y) {
      for (std::int32_t x = rect.x_begin; x < rect.x_end; ++x) {
        const PixelLoad load = count_pixel(args, tile, static_cast<float>(x) + 0.5f, static_cast<float>(y) + 0.5f);
        const std::int64_t pixel = std::int64_t{y} * args.grid.image_width + x;
        args.processed[pixel] = load.processed;
        args.contributing[pixel] = load.contributing;
      }
    }
  });
}

}  // namespace b3dgs::cpu
