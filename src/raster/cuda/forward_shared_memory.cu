// Forward blend, shared-memory: as naive, with colours and depths staged in shared memory too, so that a contributing
// splat costs no trip to global memory. A warp's pixels form a sub-tile of 8 x 4, which contributes more often as a
// whole than two rows of 16. The kernel of choice once the load is balanced.

#include "raster/cuda/forward_table.h"
#include "raster/cuda/launch.cuh"
#include "raster/cuda/tile_blend.cuh"

namespace b3dgs::cuda {
namespace {

template <int kThreads>
__global__ void __launch_bounds__(kThreads) forward_shared_memory_kernel(const BlendForwardCudaArgs args) {
  __shared__ StagedBatch<kThreads, true> batch;
  blend_tile_pixelwise(args, batch, static_cast<std::int32_t>(blockIdx.x),
                       sub_tile_pixel(static_cast<std::int32_t>(threadIdx.x)));
}

}  // namespace

void launch_forward_shared_memory(const BlendForwardCudaArgs& args, const LaunchContext& context) {
  with_tile_pixels(args.blend.grid.tile, [&](auto pixels) {
    forward_shared_memory_kernel<pixels.value><<<args.blend.grid.n_tiles(), pixels.value, 0, context.stream>>>(args);
  });
  B3DGS_CUDA_CHECK_LAUNCH();
}

KernelResources forward_shared_memory_resources(const TileShape& tile) {
  KernelResources resources;
  with_tile_pixels(tile, [&](auto pixels) {
    resources = kernel_resources(forward_shared_memory_kernel<pixels.value>, pixels.value);
  });
  return resources;
}

}  // namespace b3dgs::cuda
