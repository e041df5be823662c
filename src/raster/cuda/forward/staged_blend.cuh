// Pixel-wise blending with splats staged whole in shared memory, colours and depths too, so that a contributing splat
// costs no trip to global memory.
//
// Beyond the paper: a batch is copied while the one before is blended. A warp's pixels form a sub-tile of 8 x 4; it
// looks at 32 staged splats at once, a lane each, and visits only those whose box reaches the sub-tile. Of these it
// evaluates four before it blends them one after the other, since what decides a crowded tile's time is how long a
// thread waits for each splat.
#pragma once

#include <cuda_pipeline.h>

#include "raster/cuda/forward/tile_blend.cuh"

namespace b3dgs::cuda {

/// Splats of a batch, one for each thread of the block.
template <int kThreads>
struct Batch {
  float4 place[kThreads];
  float4 conic[kThreads];
  float4 color[kThreads];
  float2 extent[kThreads];

  /// Starts to copy a splat to the thread's place.
  __device__ __forceinline__ void copy(const BlendForwardArgs& blend, std::int32_t id) {
    const auto* const words = reinterpret_cast<const float4*>(blend.splats + id);
    __pipeline_memcpy_async(place + threadIdx.x, words, sizeof(float4));
    __pipeline_memcpy_async(conic + threadIdx.x, words + 1, sizeof(float4));
    __pipeline_memcpy_async(color + threadIdx.x, words + 2, sizeof(float4));
    __pipeline_memcpy_async(extent + threadIdx.x, blend.extents + id, sizeof(float2));
  }
};

/// One batch is blended while the next one arrives.
template <int kThreads>
using BatchPair = Batch<kThreads>[2];

/// Part of a tile's list: entries [begin, end), begin being the first of a bucket.
struct ListRange {
  std::int32_t begin, end;
};

/// The pixel of the tile that this thread blends, so that each warp has a sub-tile.
__device__ __forceinline__ TilePixel staged_pixel(const TileGrid& grid, std::int32_t tile) {
  return tile_pixel(grid, tile, sub_tile_pixel(static_cast<std::int32_t>(threadIdx.x)));
}

/// Blends the splats of a bucket, `chosen` of the 32 from `first` on. Returns the last one blended, or -1.
template <int kThreads>
__device__ __forceinline__ int blend_chosen(const Batch<kThreads>& batch, int first, unsigned chosen, float center_x,
                                            float center_y, PixelState<float>& part) {
  constexpr int kAtOnce = 4;
  int last = -1;
  while (chosen != 0) {
    int places[kAtOnce];
    bool contributes[kAtOnce];
    float alpha[kAtOnce];
#pragma unroll
    for (int k = 0; k < kAtOnce; ++k) {
      const bool is_chosen = chosen != 0;
      places[k] = is_chosen ? first + __ffs(chosen) - 1 : first;
      chosen &= chosen - 1;
      const SplatShape<float> shape = make_splat_shape({batch.place[places[k]]}, {batch.conic[places[k]]});
      const Reach<float> reach = evaluate_reach(shape, center_x, center_y);
      contributes[k] = reach.contributes && is_chosen;
      alpha[k] = evaluate_alpha(reach.power).alpha;
    }
#pragma unroll
    for (int k = 0; k < kAtOnce; ++k) {
      const float4 color = batch.color[places[k]];
      if (blend_over(part, contributes[k], alpha[k], color.x, color.y, color.z, batch.place[places[k]].w)) {
        last = places[k];
      }
    }
  }
  return last;
}

/// Blends a part of the tile's list onto the thread's pixel, staged_pixel(), and keeps what each bucket adds if that is
/// asked for. A pixel that is finished keeps its state. For all threads of the block. Returns the position in the list
/// of the last splat blended, or -1.
template <int kThreads>
__device__ __forceinline__ std::int32_t blend_staged(const BlendForwardCudaArgs& args, BatchPair<kThreads>& batches,
                                                     std::int32_t tile, const ListRange& range, const TilePixel& at,
                                                     PixelState<float>& pixel) {
  const BlendForwardArgs& blend = args.blend;
  const auto thread = static_cast<std::int32_t>(threadIdx.x);
  const float center_x = at.center_x(), center_y = at.center_y();
  const float left = __shfl_sync(kFullWarp, center_x, 0), top = __shfl_sync(kFullWarp, center_y, 0);
  const std::int32_t* const ids = blend.bins.splat_ids + blend.bins.tile_offsets[tile] + range.begin;
  const std::int32_t n = range.end - range.begin;

  std::int32_t last_blended = -1;
  if (thread < n) batches[0].copy(blend, ids[thread]);
  __pipeline_commit();
  std::int32_t next_id = thread + kThreads < n ? ids[thread + kThreads] : 0;
  for (std::int32_t start = 0; start < n; start += kThreads) {
    __pipeline_wait_prior(0);
    // One barrier a batch: this one is complete, and everyone has read the one before.
    if (__syncthreads_count(pixel.transmittance < 0) == kThreads) break;
    const Batch<kThreads>& batch = batches[start / kThreads % 2];
    if (start + kThreads + thread < n) batches[(start / kThreads + 1) % 2].copy(blend, next_id);
    __pipeline_commit();
    if (start + 2 * kThreads + thread < n) next_id = ids[start + 2 * kThreads + thread];

    const int count = n - start < kThreads ? n - start : kThreads;
    for (int bucket = 0; bucket < count; bucket += kWarpSize) {
      const bool is_alive = pixel.transmittance > 0;
      if (!__any_sync(kFullWarp, is_alive)) break;
      const int own = bucket + lane_id();
      const bool reaches =
          own < count && reaches_sub_tile(batch.place[own].x, batch.place[own].y, batch.extent[own], left, top);
      const unsigned chosen = __ballot_sync(kFullWarp, reaches);
      PixelState<float> part{pixel.transmittance, 0, 0, 0, 0};
      const int last = blend_chosen(batch, bucket, chosen, center_x, center_y, part);
      if (last >= 0) last_blended = range.begin + start + last;
      pixel = {part.transmittance, pixel.red + part.red, pixel.green + part.green, pixel.blue + part.blue,
               pixel.depth + part.depth};
      if (args.parts.light != nullptr && is_alive) {
        store_bucket_part(args, tile, range.begin + start + bucket, at.index, part);
      }
    }
  }
  return last_blended;
}

}  // namespace b3dgs::cuda
