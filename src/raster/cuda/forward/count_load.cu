// Load counting. Grid: a block per tile; thread: one pixel; lists are read from global memory without staging. Training
// calls this only for its statistics, so it does not have to be fast.

#include "raster/cuda/forward/tile_blend.cuh"
#include "raster/cuda/launch.cuh"
#include "raster/math/pixel_load.h"

namespace b3dgs::cuda {
namespace {

template <int kThreads>
__global__ void __launch_bounds__(kThreads) count_load_kernel(const CountLoadArgs args) {
  const auto tile = static_cast<std::int32_t>(blockIdx.x);
  const TilePixel at = tile_pixel(args.grid, tile, static_cast<std::int32_t>(threadIdx.x));
  if (!at.inside) return;
  PixelLoad load;
  const std::int64_t last = args.bins.tile_offsets[tile + 1];
  for (std::int64_t i = args.bins.tile_offsets[tile]; i < last; ++i) {
    const std::int32_t id = args.bins.splat_ids[i];
    const SplatShape<float> shape = make_splat_shape(load_mean(args.splats, id), load_conic(args.splats, id));
    if (!count_entry(load, shape, at.center_x(), at.center_y())) break;
  }
  const std::int64_t pixel = static_cast<std::int64_t>(at.y) * args.grid.image_width + at.x;
  args.processed[pixel] = load.processed;
  args.contributing[pixel] = load.contributing;
}

}  // namespace

void count_load(const CountLoadArgs& args, const LaunchContext& context) {
  with_tile_pixels(args.grid.tile, [&](auto pixels) {
    count_load_kernel<pixels.value><<<args.grid.n_tiles(), pixels.value, 0, context.stream>>>(args);
  });
  B3DGS_CUDA_CHECK_LAUNCH();
}

}  // namespace b3dgs::cuda
