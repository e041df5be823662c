// Forward blend, naive: a block owns a tile, a thread a pixel. The list, centres and conics are staged in shared
// memory, colours and depths are read from global memory where a splat contributes (the paper's baseline). A block runs
// as long as its slowest pixel, and the crowded tile decides the time of the whole launch.

#include "raster/cuda/forward/forward_table.h"
#include "raster/cuda/forward/pixel_wise.cuh"
#include "raster/cuda/launch.cuh"

namespace b3dgs::cuda {
namespace {

template <int kThreads>
__global__ void __launch_bounds__(kThreads) forward_naive_kernel(const BlendForwardCudaArgs args) {
  __shared__ StagedBatch<kThreads> batch;
  blend_tile_pixelwise(args, batch, static_cast<std::int32_t>(blockIdx.x));
}

}  // namespace

void launch_forward_naive(const BlendForwardCudaArgs& args, const LaunchContext& context) {
  with_tile_pixels(args.blend.grid.tile, [&](auto pixels) {
    forward_naive_kernel<pixels.value><<<args.blend.grid.n_tiles(), pixels.value, 0, context.stream>>>(args);
  });
  B3DGS_CUDA_CHECK_LAUNCH();
}

KernelResources forward_naive_resources(const TileShape& tile) {
  KernelResources resources;
  with_tile_pixels(
      tile, [&](auto pixels) { resources = kernel_resources(forward_naive_kernel<pixels.value>, pixels.value); });
  return resources;
}

}  // namespace b3dgs::cuda
