// Forward blend, shared-memory: the kernel of choice if the load is balanced.
//   Grid: a block per tile, assigned statically. Within a block: staged_blend.cuh, over the whole list.
//   Saved for the backward pass: final transmittance, last splat, and bucket parts.

#include "raster/cuda/forward/forward_table.h"
#include "raster/cuda/forward/staged_blend.cuh"
#include "raster/cuda/launch.cuh"

namespace b3dgs::cuda {
namespace {

template <int kThreads>
__global__ void __launch_bounds__(kThreads) forward_shared_memory_kernel(const BlendForwardCudaArgs args) {
  __shared__ BatchPair<kThreads> batches;
  const BlendForwardArgs& blend = args.blend;
  const auto tile = static_cast<std::int32_t>(blockIdx.x);
  const TilePixel at = staged_pixel(blend.grid, tile);
  PixelState<float> pixel{at.inside ? 1.0f : kClosedPixel, 0, 0, 0, 0};
  const std::int32_t last = blend_staged(args, batches, tile, {0, list_length(blend.bins, tile)}, at, pixel);
  if (at.inside) store_pixel(blend, at, pixel, last);
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
