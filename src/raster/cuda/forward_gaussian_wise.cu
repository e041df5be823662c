// Forward blend, Gaussian-wise: a block owns a tile; each of its warps works through 32 pixels one after the other, a
// lane for each of 32 splats. A warp never waits for its slowest pixel, but every group costs a prefix product and the
// list is read once per pixel; the block of the crowded tile is still the longest.

#include "raster/cuda/forward_table.h"
#include "raster/cuda/launch.cuh"
#include "raster/cuda/tile_blend.cuh"

namespace b3dgs::cuda {
namespace {

template <int kThreads>
__global__ void __launch_bounds__(kThreads) forward_gaussian_wise_kernel(const BlendForwardCudaArgs args) {
  const auto tile = static_cast<std::int32_t>(blockIdx.x);
  const std::int32_t begin = static_cast<std::int32_t>(threadIdx.x) / kWarpSize * kWarpSize;
  for (std::int32_t i = begin; i < begin + kWarpSize; ++i) {
    const TilePixel at = tile_pixel(args.blend.grid, tile, i);
    if (at.inside) blend_pixel_gaussian_wise(args, tile, at);
  }
}

}  // namespace

void launch_forward_gaussian_wise(const BlendForwardCudaArgs& args, const LaunchContext& context) {
  with_tile_pixels(args.blend.grid.tile, [&](auto pixels) {
    forward_gaussian_wise_kernel<pixels.value><<<args.blend.grid.n_tiles(), pixels.value, 0, context.stream>>>(args);
  });
  B3DGS_CUDA_CHECK_LAUNCH();
}

KernelResources forward_gaussian_wise_resources(const TileShape& tile) {
  KernelResources resources;
  with_tile_pixels(tile, [&](auto pixels) {
    resources = kernel_resources(forward_gaussian_wise_kernel<pixels.value>, pixels.value);
  });
  return resources;
}

}  // namespace b3dgs::cuda
