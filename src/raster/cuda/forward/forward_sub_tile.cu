// Forward blend, sub-tile: our unbalanced kernel, with a thread per pixel. Tiles are assigned statically, the longest
// list first, so that no long list remains when the others are done. Splats are staged completely and culled by
// sub-tile (staged_blend.cuh).
//
// Stored for the backward pass: final transmittance, last splat, and bucket parts (BucketParts).

#include "raster/cuda/blend_kernels.h"
#include "raster/cuda/forward/staged_blend.cuh"
#include "raster/cuda/launch.cuh"

namespace b3dgs::cuda {
namespace {

__global__ void __launch_bounds__(kStagedThreads) forward_sub_tile_kernel(const BlendForwardCudaArgs args) {
  __shared__ StagedSplats staged;
  const BlendForwardArgs& blend = args.blend;
  const std::int32_t tile = args.tiles_by_length[blockIdx.x / kStagedBlocks];
  const TilePixel at = staged_pixel(blend.grid, tile, static_cast<int>(blockIdx.x) % kStagedBlocks);
  PixelState<float> pixel{at.inside ? 1.0f : kClosedPixel, 0, 0, 0, 0};
  const std::int32_t last = blend_staged(args, staged, tile, {0, list_length(blend.bins, tile)}, at, pixel);
  if (at.inside) store_pixel(blend, at, pixel, last);
}

}  // namespace

void launch_forward_sub_tile(const BlendForwardCudaArgs& args, const LaunchContext& context) {
  const int blocks = args.blend.grid.n_tiles() * kStagedBlocks;
  launch_blocks(forward_sub_tile_kernel, blocks, kStagedThreads, context, args);
}

}  // namespace b3dgs::cuda
