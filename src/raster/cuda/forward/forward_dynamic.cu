// Forward blend, dynamic: the paper's inter-block dynamic workload distribution.
//   Grid: as many blocks as are resident at once; each takes tiles from an atomic counter until none is left. Within a
//     block: pixel_wise.cuh, as naive.
//   Barriers: two per tile to hand out the task, besides those of pixel_wise.cuh.
//   Load: the hardware's block scheduler does nearly the same for naive, so the gain is small. A single tile that costs
//     more than a block's fair share still determines the time.

#include "raster/cuda/forward/forward_table.h"
#include "raster/cuda/forward/pixel_wise.cuh"
#include "raster/cuda/launch.cuh"

namespace b3dgs::cuda {
namespace {

template <int kThreads>
__global__ void __launch_bounds__(kThreads) forward_dynamic_kernel(const BlendForwardCudaArgs args) {
  __shared__ StagedBatch<kThreads> batch;
  __shared__ std::int32_t ticket;
  const std::int32_t n_tiles = args.blend.grid.n_tiles();
  for (std::int32_t tile = take_task(args.next_task, ticket); tile < n_tiles;
       tile = take_task(args.next_task, ticket)) {
    blend_tile_pixelwise(args, batch, tile);
  }
}

}  // namespace

void launch_forward_dynamic(const BlendForwardCudaArgs& args, const LaunchContext& context) {
  with_tile_pixels(args.blend.grid.tile, [&](auto pixels) {
    const auto kernel = forward_dynamic_kernel<pixels.value>;
    kernel<<<resident_blocks(kernel, pixels.value, context), pixels.value, 0, context.stream>>>(args);
  });
  B3DGS_CUDA_CHECK_LAUNCH();
}

KernelResources forward_dynamic_resources(const TileShape& tile) {
  KernelResources resources;
  with_tile_pixels(
      tile, [&](auto pixels) { resources = kernel_resources(forward_dynamic_kernel<pixels.value>, pixels.value); });
  return resources;
}

}  // namespace b3dgs::cuda
