// State of a pixel behind a bucket, from the parts of the buckets behind it that the forward pass stored.
//
// If has_many_parts(), sum_behind_kernel first sums, for each pixel and each bucket of a long list, the contributions
// to the loss of the buckets behind. Then per-bucket reads one number instead of all parts behind.
//   Block: 32 pixels of a tile. Warp: an eighth of each pixel's parts. Lane: a pixel.
//   Sum: each warp adds its parts from back to front and stores the sum behind each bucket. Then it adds the sums of
//     the warps behind it. The order is the same in every run.
//   Shared memory: the sums of the warps. Barriers: one.
#pragma once

#include "raster/cuda/backward/splat_grad.cuh"
#include "raster/cuda/forward/tile_blend.cuh"
#include "raster/cuda/launch.cuh"
#include "raster/cuda/passes.h"
#include "raster/math/tiling.h"

namespace b3dgs::cuda {

/// Returns the index of the bucket with the pixel's last splat, which is the number of parts behind the first.
__device__ __forceinline__ std::int32_t last_bucket(std::int32_t last) {
  return last / kBucketEntries;
}

/// The parts of one pixel.
template <bool kWithDepth>
class PixelParts {
 public:
  __device__ __forceinline__ PixelParts(const BlendBackwardCudaArgs& args, std::int32_t tile, std::int32_t pixel_index)
      : parts_(args.parts), first_(args.buckets.offsets[tile] * kCudaTilePixels + pixel_index) {
    const std::int32_t segment = parts_.first_segment_of_tile != nullptr ? parts_.first_segment_of_tile[tile] : -1;
    if (segment >= 0) fronts_ = parts_.segment_fronts + std::int64_t{segment} * kCudaTilePixels + pixel_index;
  }
  /// Returns the index of the part of a bucket.
  __device__ __forceinline__ std::int64_t index(std::int32_t bucket) const {
    return first_ + std::int64_t{bucket} * kCudaTilePixels;
  }
  struct Part {
    float4 color;
    float depth, front;
  };
  __device__ __forceinline__ Part load(std::int32_t bucket) const {
    return {__ldg(parts_.color + index(bucket)), kWithDepth ? __ldg(parts_.depth + index(bucket)) : 0.0f,
            front(bucket)};
  }
  /// Returns the contribution of the part to the loss, with the meaning of ReverseState::behind.
  __device__ static __forceinline__ float loss(const Part& part, const PixelGrad& g) {
    float sum = g.color.x * part.color.y + g.color.y * part.color.z + g.color.z * part.color.w;
    if constexpr (kWithDepth) sum += g.depth * part.depth;
    return part.front * sum;
  }
  /// Returns the transmittance behind a bucket.
  __device__ __forceinline__ float transmittance(std::int32_t bucket) const {
    return front(bucket) * __ldg(&parts_.color[index(bucket)].x);
  }

 private:
  /// Returns the transmittance in front of the bucket's segment (Segments::fronts), or 1 if the list is not cut.
  __device__ __forceinline__ float front(std::int32_t bucket) const {
    return fronts_ != nullptr ? __ldg(fronts_ + std::int64_t{bucket >> parts_.segment_buckets_log2} * kCudaTilePixels)
                              : 1.0f;
  }

  const BucketParts& parts_;
  const std::int64_t first_;
  const float* fronts_ = nullptr;  // null if the list is not cut
};

/// Returns the state behind a bucket in front of the pixel's last one. `is_summed`: sum_behind_kernel has added the
/// parts of the list. `behind_list`: the result of loss_behind_list().
template <bool kWithDepth>
__device__ __forceinline__ ReverseState<float> state_behind(const BlendBackwardCudaArgs& args, bool is_summed,
                                                            std::int32_t tile, std::int32_t bucket,
                                                            std::int32_t pixel_index, std::int32_t last,
                                                            const PixelGrad& g, float behind_list) {
  const PixelParts<kWithDepth> parts(args, tile, pixel_index);
  float behind = behind_list;
  if (is_summed) {
    behind = args.behind[parts.index(bucket)];
  } else {
    for (std::int32_t k = last_bucket(last); k > bucket; --k) behind += parts.loss(parts.load(k), g);
  }
  return {parts.transmittance(bucket), behind};
}

constexpr int kSumWarps = 8, kSumThreads = kSumWarps * kWarpSize;
constexpr int kSumBlocks = kCudaTilePixels / kWarpSize;  // per tile

template <bool kWithDepth>
__global__ void __launch_bounds__(kSumThreads) sum_behind_kernel(const BlendBackwardCudaArgs args) {
  using Parts = PixelParts<kWithDepth>;
  constexpr int kAtOnce = 8;  // loads in flight
  __shared__ float sums[kSumWarps][kWarpSize];
  const int warp = static_cast<int>(threadIdx.x) / kWarpSize, lane = lane_id();
  const std::int32_t tile = args.tiles_by_length[blockIdx.x / kSumBlocks];
  const TilePixel at =
      tile_pixel(args.blend.grid, tile, static_cast<std::int32_t>(blockIdx.x) % kSumBlocks * kWarpSize + lane);
  const std::int64_t pixel = std::int64_t{at.y} * args.blend.grid.image_width + at.x;
  const std::int32_t n_parts = at.inside ? last_bucket(args.blend.last_ids[pixel]) : 0;
  if (!__any_sync(kFullWarp, n_parts > 0)) return;  // the same in all warps
  // The parts of the warp: (begin, end].
  const std::int32_t n_of_warp = (n_parts + kSumWarps - 1) / kSumWarps;
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
  __syncthreads();  // the sums of all warps are stored
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

}  // namespace b3dgs::cuda
