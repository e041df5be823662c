// Pixel-wise blending with complete splats staged in shared memory, including colour and depth, so that no contributing
// splat needs an access to global memory. Used by sub-tile and segmented.
//
//   Block: 128 pixels, half of a tile. Warp: a sub-tile of 8 x 4. Thread: a pixel.
//   Stage: each thread copies one splat of the next bucket (128 entries) asynchronously while this one is blended. One
//     barrier per bucket also counts finished pixels, to stop early.
//   Cull: a warp queues the splats whose bounding box reaches its sub-tile, a lane per splat.
//   Blend: each thread evaluates eight queued splats before blending them in order, because in a crowded tile the
//     latency per splat determines the time.
// The paper has no asynchronous copies, no culling by sub-tile and no evaluation in groups.
#pragma once

#include <cuda_pipeline.h>

#include "raster/cuda/forward/tile_blend.cuh"

namespace b3dgs::cuda {

constexpr int kStagedThreads = kBucketEntries;  // a thread per pixel, and per staged splat
constexpr int kQueueMargin = 4;                 // the last group, of four, is padded with kNothing

constexpr int kStagedBlocks = kCudaTilePixels / kStagedThreads;  // per tile

/// Shared memory of a block.
struct StagedSplats {
  /// Index of a splat that contributes nowhere.
  static constexpr int kNothing = 2 * kStagedThreads;
  // Two buckets, of which one is blended while the other is loaded, and kNothing.
  float4 mean[kNothing + 1];
  float4 conic[kNothing + 1];
  float4 color[kNothing + 1];
  float2 extent[kNothing];
  /// For each warp: indices of the bucket's splats that reach its sub-tile, padded with kNothing.
  alignas(16) int queue[kStagedThreads / kWarpSize][kBucketEntries + kQueueMargin];

  /// Starts copying splat `id`.
  __device__ __forceinline__ void copy(int index, const BlendForwardArgs& blend, std::int32_t id) {
    const auto* const words = reinterpret_cast<const float4*>(blend.splats + id);
    __pipeline_memcpy_async(mean + index, words, sizeof(float4));
    __pipeline_memcpy_async(conic + index, words + 1, sizeof(float4));
    __pipeline_memcpy_async(color + index, words + 2, sizeof(float4));
    __pipeline_memcpy_async(extent + index, blend.extents + id, sizeof(float2));
  }
  __device__ __forceinline__ void set_nothing() {
    mean[kNothing] = make_float4(0, 0, 2 * kLog2AlphaMin, 0);
    conic[kNothing] = color[kNothing] = make_float4(0, 0, 0, 0);
  }
};

/// Entries [begin, end) of a tile's list; `begin` is the first entry of a bucket.
struct ListRange {
  std::int32_t begin, end;
};

/// Returns the pixel that this thread blends in block `block` of the tile, such that each warp has a sub-tile.
__device__ __forceinline__ TilePixel staged_pixel(const TileGrid& grid, std::int32_t tile, int block) {
  return tile_pixel(grid, tile, sub_tile_pixel(block * kStagedThreads + static_cast<std::int32_t>(threadIdx.x)));
}

/// Queues those of the `count` splats from index `first` on that reach the sub-tile of the warp, whose upper left pixel
/// centre is (left, top). Returns their number.
__device__ __forceinline__ int queue_reaching(const StagedSplats& staged, int first, int count, float left, float top,
                                              int* queue) {
  int n_queued = 0;
  for (int run = 0; run < count; run += kWarpSize) {
    const int tested = run + lane_id(), index = first + tested;
    const bool reaches =
        tested < count && reaches_sub_tile(staged.mean[index].x, staged.mean[index].y, staged.extent[index], left, top);
    const unsigned reaching = __ballot_sync(kFullWarp, reaches);
    if (reaches) queue[n_queued + __popc(reaching & ((1u << lane_id()) - 1))] = index;
    n_queued += __popc(reaching);
  }
  if (lane_id() < kQueueMargin) queue[n_queued + lane_id()] = StagedSplats::kNothing;
  __syncwarp();  // the queue is visible to all lanes
  return n_queued;
}

/// Blends kAtOnce queued splats. Evaluates all of them before it blends them in order. Returns the index of the last
/// one blended, or `last`.
template <int kAtOnce>
__device__ __forceinline__ int blend_some(const StagedSplats& staged, const int* queued, float center_x, float center_y,
                                          PixelState<float>& part, int last) {
  int indices[kAtOnce];
  bool contributes[kAtOnce];
  float alpha[kAtOnce], depth[kAtOnce];
#pragma unroll
  for (int k = 0; k < kAtOnce; k += 4) {
    const int4 four = *reinterpret_cast<const int4*>(queued + k);
    indices[k] = four.x, indices[k + 1] = four.y, indices[k + 2] = four.z, indices[k + 3] = four.w;
  }
#pragma unroll
  for (int k = 0; k < kAtOnce; ++k) {
    const float4 mean = staged.mean[indices[k]];
    const Footprint<float> footprint =
        evaluate_footprint(make_splat_shape(mean, staged.conic[indices[k]]), center_x, center_y);
    contributes[k] = footprint.contributes;
    alpha[k] = evaluate_alpha(footprint.power).alpha;
    depth[k] = mean.w;
  }
#pragma unroll
  for (int k = 0; k < kAtOnce; ++k) {
    const float4 color = staged.color[indices[k]];
    if (blend_over(part, contributes[k], alpha[k], color.x, color.y, color.z, depth[k])) last = indices[k];
  }
  return last;
}

/// Blends the first `n` queued splats. Returns the index of the last one blended, or -1.
__device__ __forceinline__ int blend_queued(const StagedSplats& staged, const int* queue, int n, float center_x,
                                            float center_y, PixelState<float>& part) {
  int last = -1, next = 0;
  // Eight at a time while more than four remain, which reads at most kQueueMargin - 1 entries past the last one.
  for (; next + 4 < n; next += 8) {
    if (next % kWarpSize == 0 && !__any_sync(kFullWarp, is_open(part.transmittance))) return last;
    last = blend_some<8>(staged, queue + next, center_x, center_y, part, last);
  }
  return next < n ? blend_some<4>(staged, queue + next, center_x, center_y, part, last) : last;
}

/// Blends entries of a tile's list onto this thread's pixel, which is staged_pixel(), and stores bucket parts if
/// args.parts has memory for them. A finished pixel keeps its state. Must be called by all threads of the block.
/// Returns the position in the list of the last splat blended, or -1.
__device__ __forceinline__ std::int32_t blend_staged(const BlendForwardCudaArgs& args, StagedSplats& staged,
                                                     std::int32_t tile, const ListRange& range, const TilePixel& at,
                                                     PixelState<float>& pixel) {
  const BlendForwardArgs& blend = args.blend;
  const auto thread = static_cast<std::int32_t>(threadIdx.x);
  const float center_x = at.center_x(), center_y = at.center_y();
  const float left = __shfl_sync(kFullWarp, center_x, 0), top = __shfl_sync(kFullWarp, center_y, 0);
  int* const queue = staged.queue[thread / kWarpSize];
  const std::int32_t* const ids = blend.bins.splat_ids + blend.bins.tile_offsets[tile] + range.begin;
  const std::int32_t n = range.end - range.begin;

  // Start copying the first bucket, and load the list entry for the second.
  std::int32_t last_blended = -1;
  if (thread < n) staged.copy(thread, blend, ids[thread]);
  __pipeline_commit();
  if (thread == 0) staged.set_nothing();
  std::int32_t next_id = thread + kStagedThreads < n ? ids[thread + kStagedThreads] : 0;
  for (std::int32_t start = 0; start < n; start += kStagedThreads) {
    __pipeline_wait_prior(0);
    // The one barrier per bucket. This bucket is complete, and all threads have finished with the previous one.
    if (__syncthreads_count(is_finished(pixel.transmittance)) == kStagedThreads) break;
    const int first = start / kStagedThreads % 2 * kStagedThreads;  // index of this bucket's first splat
    if (start + kStagedThreads + thread < n) staged.copy(kStagedThreads - first + thread, blend, next_id);
    __pipeline_commit();
    if (start + 2 * kStagedThreads + thread < n) next_id = ids[start + 2 * kStagedThreads + thread];

    const bool is_alive = is_open(pixel.transmittance);
    if (!__any_sync(kFullWarp, is_alive)) continue;
    const int n_queued = queue_reaching(staged, first, min(n - start, kStagedThreads), left, top, queue);
    PixelState<float> part{pixel.transmittance, 0, 0, 0, 0};
    const int last = blend_queued(staged, queue, n_queued, center_x, center_y, part);
    if (last >= 0) last_blended = range.begin + start + last - first;
    pixel = sum_of(pixel, part);
    if (args.parts.color != nullptr && is_alive) store_bucket_part(args, tile, range.begin + start, at.index, part);
  }
  return last_blended;
}

}  // namespace b3dgs::cuda
