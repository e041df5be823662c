// Sums, for each pixel, what the buckets behind each bucket of a long list add to the loss, if has_many_parts():
// per-bucket then reads one number instead of all parts behind.
//
//   Block: 32 pixels of a tile. Warp: an eighth of each pixel's parts. Lane: a pixel.
//   Sum: each warp adds up its parts from back to front and stores the sum behind each bucket; then adds those of the
//     warps behind it. The order is the same in every run.
//   Shared memory: the warps' sums. Barriers: one.

#include "raster/cuda/backward/parts_behind.cuh"
#include "raster/cuda/blend_kernels.h"
#include "raster/cuda/forward/tile_blend.cuh"
#include "raster/cuda/launch.cuh"

namespace b3dgs::cuda {
namespace {

constexpr int kWarps = 8, kThreads = kWarps * kWarpSize;
constexpr int kBlocks = kCudaTilePixels / kWarpSize;  // for a tile

template <bool kWithDepth>
__global__ void __launch_bounds__(kThreads) sum_behind_kernel(const BlendBackwardCudaArgs args) {
  using Parts = PixelParts<kWithDepth>;
  constexpr int kAtOnce = 8;  // loads in flight
  __shared__ float sums[kWarps][kWarpSize];
  const int warp = static_cast<int>(threadIdx.x) / kWarpSize, lane = lane_id();
  const std::int32_t tile = args.tiles_by_length[blockIdx.x / kBlocks];
  const TilePixel at =
      tile_pixel(args.blend.grid, tile, static_cast<std::int32_t>(blockIdx.x) % kBlocks * kWarpSize + lane);
  const std::int64_t pixel = std::int64_t{at.y} * args.blend.grid.image_width + at.x;
  const std::int32_t n_parts = at.inside ? last_bucket(args.blend.last_ids[pixel]) : 0;
  if (!__any_sync(kFullWarp, n_parts > 0)) return;  // the same in all warps
  // The warp's parts: (begin, end].
  const std::int32_t n_of_warp = (n_parts + kWarps - 1) / kWarps;
  const std::int32_t end = max(n_parts - warp * n_of_warp, 0), begin = max(end - n_of_warp, 0);
  const Parts parts(args, tile, at.index);
  PixelGrad g{};
  if (n_parts > 0) g = load_pixel_grad(args.blend, pixel);
  float sum = warp == 0 && n_parts > 0 ? loss_behind_list(args.blend, pixel, g) : 0.0f;
  for (std::int32_t first = end; first > begin; first -= kAtOnce) {
    typename Parts::Part part[kAtOnce];
#pragma unroll
    for (int k = 0; k < kAtOnce; ++k) part[k] = parts.load(max(first - k, begin + 1));
#pragma unroll
    for (int k = 0; k < kAtOnce; ++k) {
      if (first - k <= begin) break;
      sum += Parts::loss(part[k], g);
      args.behind[parts.index(first - k - 1)] = sum;
    }
  }
  sums[warp][lane] = sum;
  __syncthreads();  // all sums
  float behind = 0;
  for (int w = 0; w < warp; ++w) behind += sums[w][lane];
  for (std::int32_t first = end; first > begin; first -= kAtOnce) {
    float own[kAtOnce];
#pragma unroll
    for (int k = 0; k < kAtOnce; ++k) own[k] = args.behind[parts.index(max(first - k, begin + 1) - 1)];
#pragma unroll
    for (int k = 0; k < kAtOnce; ++k) {
      if (first - k > begin) args.behind[parts.index(first - k - 1)] = own[k] + behind;
    }
  }
}

}  // namespace

void launch_sum_behind(const BlendBackwardCudaArgs& args, const LaunchContext& context) {
  const int blocks = args.n_long_lists * kBlocks;
  if (args.blend.grad.depth != nullptr) {
    sum_behind_kernel<true><<<blocks, kThreads, 0, context.stream>>>(args);
  } else {
    sum_behind_kernel<false><<<blocks, kThreads, 0, context.stream>>>(args);
  }
  B3DGS_CUDA_CHECK_LAUNCH();
}

}  // namespace b3dgs::cuda
