// Pixel-wise blending with complete splats staged in shared memory, including colour and depth, so that no contributing
// splat needs an access to global memory. Used by shared-memory and segmented.
//
//   Block: a tile, or a segment of its list. Warp: a sub-tile of 8 x 4 pixels. Thread: one pixel.
//   Stage: each thread copies one splat of the next batch asynchronously while the current batch is blended (two
//     batches in shared memory, one barrier per batch, which also counts finished pixels to stop early).
//   Cull: for every 32 staged splats a warp tests, a lane per splat, whose bounding box reaches the sub-tile.
//   Blend: each thread evaluates four of the remaining splats before blending them in order, because in a crowded tile
//     the latency per splat determines the time.
// Asynchronous copies, culling by sub-tile and evaluation in fours are not in the paper.
#pragma once

#include <cuda_pipeline.h>

#include "raster/cuda/forward/tile_blend.cuh"

namespace b3dgs::cuda {

/// A batch of splats in shared memory, one per thread of the block.
template <int kThreads>
struct Batch {
  float4 mean[kThreads];
  float4 conic[kThreads];
  float4 color[kThreads];
  float2 extent[kThreads];

  /// Starts copying a splat to this thread's entry.
  __device__ __forceinline__ void copy(const BlendForwardArgs& blend, std::int32_t id) {
    const auto* const words = reinterpret_cast<const float4*>(blend.splats + id);
    __pipeline_memcpy_async(mean + threadIdx.x, words, sizeof(float4));
    __pipeline_memcpy_async(conic + threadIdx.x, words + 1, sizeof(float4));
    __pipeline_memcpy_async(color + threadIdx.x, words + 2, sizeof(float4));
    __pipeline_memcpy_async(extent + threadIdx.x, blend.extents + id, sizeof(float2));
  }
};

/// One batch is blended while the next one arrives.
template <int kThreads>
using BatchPair = Batch<kThreads>[2];

/// Entries [begin, end) of a tile's list; `begin` is the first entry of a bucket.
struct ListRange {
  std::int32_t begin, end;
};

/// The pixel that this thread blends, such that each warp has a sub-tile.
__device__ __forceinline__ TilePixel staged_pixel(const TileGrid& grid, std::int32_t tile) {
  return tile_pixel(grid, tile, sub_tile_pixel(static_cast<std::int32_t>(threadIdx.x)));
}

/// Blends those of 32 splats whose bit in `chosen` is set; `first` is the first one's entry in the batch.
/// Returns the batch entry of the last one blended, or -1.
template <int kThreads>
__device__ __forceinline__ int blend_chosen(const Batch<kThreads>& batch, int first, unsigned chosen, float center_x,
                                            float center_y, PixelState<float>& part) {
  constexpr int kAtOnce = 4;  // independent evaluations that hide the latency of shared memory and the exponential
  int last = -1;
  while (chosen != 0) {
    int indices[kAtOnce];
    bool contributes[kAtOnce];
    float alpha[kAtOnce];
#pragma unroll
    for (int k = 0; k < kAtOnce; ++k) {
      const bool is_chosen = chosen != 0;
      indices[k] = is_chosen ? first + __ffs(chosen) - 1 : first;
      chosen &= chosen - 1;
      const SplatShape<float> shape = make_splat_shape({batch.mean[indices[k]]}, {batch.conic[indices[k]]});
      const Footprint<float> footprint = evaluate_footprint(shape, center_x, center_y);
      contributes[k] = footprint.contributes && is_chosen;
      alpha[k] = evaluate_alpha(footprint.power).alpha;
    }
#pragma unroll
    for (int k = 0; k < kAtOnce; ++k) {
      const float4 color = batch.color[indices[k]];
      if (blend_over(part, contributes[k], alpha[k], color.x, color.y, color.z, batch.mean[indices[k]].w)) {
        last = indices[k];
      }
    }
  }
  return last;
}

/// Blends entries of a tile's list onto this thread's pixel, which is staged_pixel(), and stores bucket parts if
/// args.parts asks for them. A finished pixel keeps its state. Must be called by all threads of the block. Returns the
/// position in the list of the last splat blended, or -1.
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

  // Start copying the first batch, and load the list entry for the second.
  std::int32_t last_blended = -1;
  if (thread < n) batches[0].copy(blend, ids[thread]);
  __pipeline_commit();
  std::int32_t next_id = thread + kThreads < n ? ids[thread + kThreads] : 0;
  for (std::int32_t start = 0; start < n; start += kThreads) {
    __pipeline_wait_prior(0);
    // The one barrier per batch: this batch is complete, and all threads have finished with the previous one.
    if (__syncthreads_count(is_finished(pixel.transmittance)) == kThreads) break;
    const Batch<kThreads>& batch = batches[start / kThreads % 2];
    if (start + kThreads + thread < n) batches[(start / kThreads + 1) % 2].copy(blend, next_id);
    __pipeline_commit();
    if (start + 2 * kThreads + thread < n) next_id = ids[start + 2 * kThreads + thread];

    const int count = n - start < kThreads ? n - start : kThreads;
    for (int bucket = 0; bucket < count; bucket += kBucketEntries) {
      const bool is_alive = is_open(pixel.transmittance);
      PixelState<float> part{pixel.transmittance, 0, 0, 0, 0};
      const int bucket_end = bucket + kBucketEntries < count ? bucket + kBucketEntries : count;
      for (int run = bucket; run < bucket_end; run += kWarpSize) {
        if (!__any_sync(kFullWarp, is_open(part.transmittance))) break;
        // Cull: lane l tests splat l of the run against the warp's sub-tile.
        const int tested = run + lane_id();
        const bool reaches = tested < count && reaches_sub_tile(batch.mean[tested].x, batch.mean[tested].y,
                                                                batch.extent[tested], left, top);
        const unsigned chosen = __ballot_sync(kFullWarp, reaches);
        const int last = blend_chosen(batch, run, chosen, center_x, center_y, part);
        if (last >= 0) last_blended = range.begin + start + last;
      }
      pixel = {part.transmittance, pixel.red + part.red, pixel.green + part.green, pixel.blue + part.blue,
               pixel.depth + part.depth};
      if (args.parts.color != nullptr && is_alive) {
        store_bucket_part(args, tile, range.begin + start + bucket, at.index, part);
      }
    }
  }
  return last_blended;
}

}  // namespace b3dgs::cuda
