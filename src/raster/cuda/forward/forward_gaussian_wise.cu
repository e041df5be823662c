// Forward blend, Gaussian-wise.
//   Grid: a block per tile, assigned statically. Warp: 32 of the tile's pixels, one after the other. Lane: one of 32
//     consecutive splats of the list (a group).
//   Per group: evaluate the splats at the pixel, then a prefix product over the lanes (gaussian_wise.cuh).
//   Shared memory and barriers: none.
//   Load: no lane waits for another pixel, but every group costs a prefix product, the list is read once per pixel, and
//     the block of the most crowded tile still runs longest.
//   Saved for the backward pass: final transmittance, last splat, and bucket parts.

#include "raster/cuda/blend_kernels.h"
#include "raster/cuda/forward/gaussian_wise.cuh"
#include "raster/cuda/launch.cuh"

namespace b3dgs::cuda {
namespace {

constexpr int kThreads = kCudaTilePixels;

/// Blends one pixel with the whole warp.
template <StoredParts kStored>
__device__ __forceinline__ void blend_pixel(const BlendForwardCudaArgs& args, std::int32_t tile, const TilePixel& at) {
  const BlendForwardArgs& blend = args.blend;
  const std::int64_t first = blend.bins.tile_offsets[tile];
  const auto n = static_cast<std::int32_t>(blend.bins.tile_offsets[tile + 1] - first);
  GaussianWisePixel<kStored> pixel(args, tile, at);
  // All lanes run every round; beyond the end of the list they do not contribute.
  for (std::int32_t group = 0; group < n && !pixel.is_finished(); group += kWarpSize) {
    const std::int32_t entry = group + lane_id();
    const std::int32_t id = blend.bins.splat_ids[first + (entry < n ? entry : n - 1)];
    const SplatShape<float> shape = make_splat_shape(load_mean(blend.splats, id), load_conic(blend.splats, id));
    const Footprint<float> footprint = evaluate_footprint(shape, at.center_x(), at.center_y());
    const bool contributes = footprint.contributes && entry < n;
    if (!__any_sync(kFullWarp, contributes)) continue;
    pixel.blend({contributes, footprint.power, entry}, [&] {
      const float4 color = load_color(blend.splats, id);
      return make_float4(color.x, color.y, color.z, __ldg(&blend.splats[id].depth));
    });
  }
  pixel.store();
}

template <StoredParts kStored>
__global__ void __launch_bounds__(kThreads) forward_gaussian_wise_kernel(const BlendForwardCudaArgs args) {
  const auto tile = static_cast<std::int32_t>(blockIdx.x);
  const std::int32_t begin = static_cast<std::int32_t>(threadIdx.x) / kWarpSize * kWarpSize;
  for (std::int32_t i = begin; i < begin + kWarpSize; ++i) {
    const TilePixel at = tile_pixel(args.blend.grid, tile, i);
    if (at.inside) blend_pixel<kStored>(args, tile, at);
  }
}

}  // namespace

void launch_forward_gaussian_wise(const BlendForwardCudaArgs& args, const LaunchContext& context) {
  with_stored_parts(args.parts, [&](auto stored) {
    launch_blocks(forward_gaussian_wise_kernel<stored.value>, args.blend.grid.n_tiles(), kThreads, context, args);
  });
}

}  // namespace b3dgs::cuda
