// Forward blend, combined: blocks of four warps take tasks of 2 x 2 pixels from the pool, a warp for each pixel, a lane
// for each splat (the paper's fine-grained combined load balancing). A crowded tile becomes 32 or 64 tasks for as many
// blocks, so the longest task is one pixel's list divided by 32. Loses where lists are short: a group costs the same
// for one contributing splat as for 32.

#include "raster/cuda/forward_table.h"
#include "raster/cuda/launch.cuh"
#include "raster/cuda/tile_blend.cuh"

namespace b3dgs::cuda {
namespace {

constexpr int kThreads = 4 * kWarpSize;

__global__ void __launch_bounds__(kThreads)
    forward_combined_kernel(const BlendForwardCudaArgs args, const std::int32_t n_tasks) {
  __shared__ std::int32_t ticket;
  const std::int32_t own = static_cast<std::int32_t>(threadIdx.x) / kWarpSize;
  for (std::int32_t task = take_task(args.next_task, ticket); task < n_tasks;
       task = take_task(args.next_task, ticket)) {
    const TaskPixels pixels = quad_task(args.blend.grid, task);
    const std::int32_t x = pixels.rect.x_begin + own % 2, y = pixels.rect.y_begin + own / 2;
    if (x < pixels.rect.x_end && y < pixels.rect.y_end) {
      const TileShape shape = args.blend.grid.tile;
      const TilePixel at{x, y, y % shape.height * shape.width + x % shape.width, true};
      blend_pixel_gaussian_wise(args, pixels.tile, at);
    }
  }
}

}  // namespace

void launch_forward_combined(const BlendForwardCudaArgs& args, const LaunchContext& context) {
  const std::int64_t n_tasks = n_quad_tasks(args.blend.grid);
  B3DGS_CHECK(n_tasks < std::int64_t{1} << 30, "tasks are counted in 32 bits; the image has ", n_tasks);
  forward_combined_kernel<<<resident_blocks(forward_combined_kernel, kThreads, context), kThreads, 0, context.stream>>>(
      args, static_cast<std::int32_t>(n_tasks));
  B3DGS_CUDA_CHECK_LAUNCH();
}

KernelResources forward_combined_resources(const TileShape&) {
  return kernel_resources(forward_combined_kernel, kThreads);
}

}  // namespace b3dgs::cuda
