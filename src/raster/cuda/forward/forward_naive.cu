// Forward blend, naive: the paper's baseline, and the reference if kernels disagree.
//   Grid: a block per tile, assigned statically. Within a block: pixel_wise.cuh.
//   Load: a block runs as long as its slowest pixel, and the most crowded tile determines the time of the launch.

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
