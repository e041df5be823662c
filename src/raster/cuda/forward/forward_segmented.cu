// Forward blend, segmented: shared-memory, with long lists cut into segments of 1024 entries that are blended in
// parallel, if the longest has much of the work (longest_whole_list()). Balanced like combined, with the cost per splat
// of a pixel-wise kernel. Not in the paper, whose balanced kernel distributes a crowded tile over its pixels.
//
// Compositing is associative: a segment is blended as if the transmittance in front of it were 1, and (transmittance,
// colour) of a list's segments are then combined front to back. The stop at transmittance 1e-4 is not associative: the
// segment in which a pixel finishes is blended again for that pixel, from the true transmittance.
//
//   list           |   segment 0   |   segment 1   |   segment 2   | 3 |
//   blended from   T = 1           T = 1           T = 1           T = 1     forward_segmented, in parallel
//   joined         T = 1 --------> 0.5 ----------> 0.01 ---------> finished  join_segments, front to back
//   blended again                                  |from T = 0.01 |          end_pixels
//
// Kernel 1, cut_lists: one block writes the list of tasks, the segments ordered by their number within their list.
// Kernel 2, forward_segmented: a block per 128 pixels of a segment or whole list. The first segments of all lists run
//   first, then the second ones, and so on. Segments behind finished pixels would be wasted work, so a block first
//   multiplies the transmittances of the segments in front that are already done (a flag each, stored with release and
//   loaded with acquire), and skips its segment if no pixel can still be visible. Which segments are skipped depends on
//   timing. The image does not: a skipped segment is behind the end of all its pixels.
// Kernel 3, join_segments: a block per tile, a thread per pixel. Combines the pixel's segments front to back, up to the
//   one in which it finishes, and writes the pixel unless that segment has to be blended again.
// Kernel 4, end_pixels: a block per 128 pixels of a task blends the segment again for the pixels that finish in it, and
//   writes them.
//
// Shared memory: staged splats in kernels 2 and 4 (staged_blend.cuh); counters in kernel 1.
// Barriers: one per bucket of splats, one to skip a segment, and one before it is marked as done.
// Saved for the backward pass: final transmittance, last splat, bucket parts relative to their segment, and the
//   transmittance in front of each segment (Segments::fronts).

#include <cub/block/block_scan.cuh>
#include <cuda/atomic>

#include "raster/checks.h"
#include "raster/cuda/blend_kernels.h"
#include "raster/cuda/forward/staged_blend.cuh"
#include "raster/cuda/launch.cuh"

namespace b3dgs::cuda {
namespace {

constexpr int kCutThreads = 1024;  // one block; also how many segment numbers are sorted exactly

/// Number of segments of a tile's list; 1 if it is not cut.
__device__ __forceinline__ std::int32_t n_segments(const BlendForwardCudaArgs& args, std::int32_t tile) {
  const std::int32_t length = list_length(args.blend.bins, tile);
  return length > args.longest_whole ? (length + kSegmentEntries - 1) / kSegmentEntries : 1;
}

/// Lists all segments except the first of each list, sorted by their number within the list (numbers from
/// kCutThreads - 1 on in any order). This is a counting sort: tiles are ranked by their number of segments, most first.
/// The tiles that have a segment number k are then the first n_with[k + 1] ranks, and the task of segment k of a tile
/// is at first_of_number[k] + rank.
__global__ void __launch_bounds__(kCutThreads) cut_lists_kernel(const BlendForwardCudaArgs args) {
  using BlockScan = cub::BlockScan<std::int32_t, kCutThreads>;
  constexpr std::int32_t kLast = kCutThreads - 1;  // this number and all above share a counter
  __shared__ typename BlockScan::TempStorage scan_memory;
  // Indexed by a number of segments:
  __shared__ std::int32_t next_rank[kCutThreads];  // first a count of tiles, then the next rank for such a tile
  __shared__ std::int32_t n_with[kCutThreads];     // tiles with that many segments or more
  // Indexed by a segment's number:
  __shared__ std::int32_t first_of_number[kCutThreads];  // index of the first task with that number
  __shared__ std::int32_t n_beyond;                      // number of segments with numbers from kLast on
  const Segments& segments = args.segments;
  const auto thread = static_cast<std::int32_t>(threadIdx.x);
  const std::int32_t n_tiles = args.blend.grid.n_tiles();
  next_rank[thread] = 0;
  if (thread == 0) n_beyond = 0;
  __syncthreads();

  // Count tiles by their number of segments, and assign each cut list a range of segment indices.
  for (std::int32_t tile = thread; tile < n_tiles; tile += kCutThreads) {
    const std::int32_t count = n_segments(args, tile);
    // A list of two or more segments fills more than half of them, so twice the entries in front of the list, divided
    // by the segment length, leaves enough indices for the lists in front (Segments).
    segments.first_of_tile[tile] =
        count > 1 ? static_cast<std::int32_t>(2 * args.blend.bins.tile_offsets[tile] / kSegmentEntries) : -1;
    if (count > 1) atomicAdd(next_rank + min(count, kLast), 1);
    if (count > kLast) atomicAdd(&n_beyond, count - kLast);
  }
  __syncthreads();
  // Scan from the largest number of segments down: ranks, and where each segment number begins in the list of tasks.
  const std::int32_t n_tiles_with = next_rank[kLast - thread];
  std::int32_t n_ranked = 0;
  BlockScan(scan_memory).InclusiveSum(n_tiles_with, n_ranked);
  n_with[kLast - thread] = n_ranked;
  next_rank[kLast - thread] = n_ranked - n_tiles_with;
  __syncthreads();
  std::int32_t n_listed = 0;
  BlockScan(scan_memory)
      .ExclusiveSum(thread > 0 && thread < kLast ? n_with[thread + 1] : 0, first_of_number[thread], n_listed);
  if (thread == 0) *segments.n_tasks = n_listed + n_beyond;
  __syncthreads();

  // Write the tasks.
  for (std::int32_t tile = thread; tile < n_tiles; tile += kCutThreads) {
    const std::int32_t count = n_segments(args, tile);
    if (count == 1) continue;
    const std::int32_t first = segments.first_of_tile[tile], rank = atomicAdd(next_rank + min(count, kLast), 1);
    for (std::int32_t k = 0; k < kSegmentBlocks * count; ++k) segments.is_done[kSegmentBlocks * first + k] = 0;
    for (std::int32_t k = 1; k < count; ++k) {
      segments.tasks[k < kLast ? first_of_number[k] + rank : atomicAdd(first_of_number + kLast, 1)] = {tile, k};
    }
  }
}

/// Reads task `number` of the list. Returns false if there are fewer.
__device__ __forceinline__ bool take_listed(const Segments& segments, std::int32_t number, SegmentTask& task) {
  if (number >= *segments.n_tasks) return false;
  task = segments.tasks[number];
  return true;
}

/// Task `number`: the first n_tiles are the first segment (or the whole list) of each tile, the others are listed.
__device__ __forceinline__ bool take_segment(const BlendForwardCudaArgs& args, std::int32_t number, SegmentTask& task) {
  const std::int32_t n_tiles = args.blend.grid.n_tiles();
  if (number >= n_tiles) return take_listed(args.segments, number - n_tiles, task);
  task = {args.tiles_by_length[number], 0};
  return true;
}

/// The segment of a task.
struct ListSegment {
  std::int32_t tile;
  std::int32_t first;  // index of the list's first segment, -1 if the list is not cut
  std::int32_t index;  // index of this segment
  ListRange range;     // its entries
  __device__ ListSegment(const BlendForwardCudaArgs& args, const SegmentTask& task)
      : tile(task.tile), first(args.segments.first_of_tile[task.tile]), index(first + task.segment) {
    const std::int32_t length = list_length(args.blend.bins, tile), begin = task.segment * kSegmentEntries;
    range = {begin, first >= 0 && begin + kSegmentEntries < length ? begin + kSegmentEntries : length};
  }
};

/// Upper bound of the pixel's transmittance in front of this segment: the product over the segments that are done. It
/// is computed in the order in which join_segments_kernel multiplies, so that it is a bound despite rounding. Must be
/// called by all threads of the block, the tile's `block`, including those of pixels outside the image.
template <int kTilePixels>
__device__ __forceinline__ float transmittance_bound(const Segments& segments, const ListSegment& segment, int block,
                                                     std::int32_t pixel_index) {
  constexpr int kAtOnce = 4;  // loads in flight
  float bound = 1;
  for (std::int32_t start = segment.first; start < segment.index; start += kWarpSize) {
    const std::int32_t index = start + lane_id();
    bool is_done = false;
    if (index < segment.index) {
      ::cuda::atomic_ref<std::int32_t, ::cuda::thread_scope_device> done(
          segments.is_done[kSegmentBlocks * index + block]);
      is_done = done.load(::cuda::memory_order_acquire) != 0;
    }
    unsigned ready = __ballot_sync(kFullWarp, is_done);
    __syncwarp();  // makes what one lane acquired visible to the whole warp
    while (ready != 0) {
      float factor[kAtOnce];
#pragma unroll
      for (int k = 0; k < kAtOnce; ++k) {
        const std::int32_t from = (start + __ffs(ready) - 1) * kTilePixels + pixel_index;
        factor[k] = ready != 0 ? __ldcg(segments.transmittance + from) : 1.0f;
        ready &= ready - 1;
      }
#pragma unroll
      for (int k = 0; k < kAtOnce; ++k) bound *= factor[k] > 0 ? factor[k] : 0.0f;
    }
  }
  return bound;
}

template <int kTilePixels>
__global__ void __launch_bounds__(kStagedThreads) forward_segmented_kernel(const BlendForwardCudaArgs args) {
  constexpr int kBlocks = kStagedBlocks<kTilePixels>;
  __shared__ StagedSplats staged;
  const BlendForwardArgs& blend = args.blend;
  const Segments& segments = args.segments;
  SegmentTask task;
  if (!take_segment(args, static_cast<std::int32_t>(blockIdx.x) / kBlocks, task)) return;
  const int block = static_cast<int>(blockIdx.x) % kBlocks;
  const ListSegment segment(args, task);
  const TilePixel at = staged_pixel(blend.grid, segment.tile, block);
  const std::int32_t pixel_of_segment = segment.index * kTilePixels + at.index;
  // Skip what cannot be visible.
  bool is_alive = at.inside, is_any_alive = true;
  if (segment.index > segment.first) {
    segments.fronts[pixel_of_segment] = {1};
    const float bound =
        transmittance_bound<kTilePixels>(segments, segment, block, at.index);  // uses votes: all lanes must call it
    is_alive = is_alive && !is_saturated(bound);
    is_any_alive = __syncthreads_or(is_alive) != 0;
  }

  // Blend as if the transmittance in front were 1. Pixels outside the image or already finished start as finished.
  PixelState<float> pixel{is_alive ? 1.0f : kClosedPixel, 0, 0, 0, 0};
  const std::int32_t last = is_any_alive ? blend_staged(args, staged, segment.tile, segment.range, at, pixel) : -1;
  if (segment.first < 0) {
    if (at.inside) store_pixel(blend, at, pixel, last);
    return;
  }
  segments.transmittance[pixel_of_segment] = pixel.transmittance;
  segments.color_depth[pixel_of_segment] = make_float4(pixel.red, pixel.green, pixel.blue, pixel.depth);
  segments.last[pixel_of_segment] = last;
  // Publish the segment for blocks that are behind it in the same list.
  __syncthreads();  // all threads have written
  if (threadIdx.x == 0) {
    ::cuda::atomic_ref<std::int32_t, ::cuda::thread_scope_device> done(
        segments.is_done[kSegmentBlocks * segment.index + block]);
    done.store(1, ::cuda::memory_order_release);
  }
}

/// Combines each pixel's segments front to back. If the pixel finishes in a segment that has to be blended again,
/// leaves the state in front of it to end_pixels_kernel, in place of the segment's.
template <int kThreads>
__global__ void __launch_bounds__(kThreads) join_segments_kernel(const BlendForwardCudaArgs args) {
  constexpr int kAtOnce = 8;  // loads in flight
  const Segments& segments = args.segments;
  const auto tile = static_cast<std::int32_t>(blockIdx.x);
  const std::int32_t first = segments.first_of_tile[tile];
  if (first < 0) return;
  const TilePixel at = tile_pixel(args.blend.grid, tile, static_cast<std::int32_t>(threadIdx.x));
  if (!at.inside) {
    segments.fronts[first * kThreads + at.index] = {1};
    return;
  }

  const std::int32_t count = n_segments(args, tile);
  PixelState<float> pixel{1, 0, 0, 0, 0};
  std::int32_t last = -1;
  for (std::int32_t start = 0; start < count; start += kAtOnce) {
    const std::int32_t index = (first + start) * kThreads + at.index;
    float transmittance[kAtOnce];
    float4 color_depth[kAtOnce];
    std::int32_t last_of_segment[kAtOnce];
#pragma unroll
    for (int k = 0; k < kAtOnce; ++k) {
      const std::int32_t from = index + (start + k < count ? k : 0) * kThreads;
      transmittance[k] = segments.transmittance[from];
      color_depth[k] = segments.color_depth[from];
      last_of_segment[k] = segments.last[from];
    }
#pragma unroll
    for (int k = 0; k < kAtOnce; ++k) {
      if (start + k >= count) break;
      const std::int32_t to = index + k * kThreads;
      const float before = pixel.transmittance, behind = before * transmittance[k];
      // With transmittance 1 in front, the segment was blended exactly as it should be. Otherwise, if the product falls
      // below the minimum, or the segment alone finishes the pixel (negative), it has to be blended again.
      const bool is_exact = before == 1;
      if (is_saturated(behind) && !is_exact) {
        segments.fronts[to] = SegmentFront::blend_again_from(before);
        segments.color_depth[to] = make_float4(pixel.red, pixel.green, pixel.blue, pixel.depth);
        segments.last[to] = last;
        return;
      }
      segments.fronts[to] = {before};
      pixel = {behind, pixel.red + before * color_depth[k].x, pixel.green + before * color_depth[k].y,
               pixel.blue + before * color_depth[k].z, pixel.depth + before * color_depth[k].w};
      if (last_of_segment[k] >= 0) last = last_of_segment[k];
      if (is_finished(behind)) {
        store_pixel(args.blend, at, pixel, last);
        return;
      }
    }
  }
  store_pixel(args.blend, at, pixel, last);
}

/// Blends segments again for the pixels that finish in them. Their bucket parts are then absolute instead of relative
/// to the segment.
template <int kTilePixels>
__global__ void __launch_bounds__(kStagedThreads) end_pixels_kernel(const BlendForwardCudaArgs args) {
  constexpr int kBlocks = kStagedBlocks<kTilePixels>;
  __shared__ StagedSplats staged;
  const Segments& segments = args.segments;
  SegmentTask task;
  // Only listed segments: the first of a list has transmittance 1 in front of it and is never blended again.
  if (!take_listed(segments, static_cast<std::int32_t>(blockIdx.x) / kBlocks, task)) return;
  const ListSegment segment(args, task);
  const TilePixel at = staged_pixel(args.blend.grid, segment.tile, static_cast<int>(blockIdx.x) % kBlocks);
  const std::int32_t pixel_of_segment = segment.index * kTilePixels + at.index;
  const SegmentFront front = segments.fronts[pixel_of_segment];
  const bool ends = front.is_to_blend_again();  // the pixel finishes in this segment
  if (__syncthreads_or(ends) == 0) return;

  PixelState<float> pixel{kClosedPixel, 0, 0, 0, 0};
  if (ends) {
    const float4 color_depth = segments.color_depth[pixel_of_segment];
    pixel = {front.transmittance_to_blend_from(), color_depth.x, color_depth.y, color_depth.z, color_depth.w};
  }
  const std::int32_t last = blend_staged(args, staged, segment.tile, segment.range, at, pixel);
  if (!ends) return;
  store_pixel(args.blend, at, pixel, last >= 0 ? last : segments.last[pixel_of_segment]);
  segments.fronts[pixel_of_segment] = {1};
}

}  // namespace

void launch_forward_segmented(const BlendForwardCudaArgs& args, const LaunchContext& context) {
  static_assert(kSegmentEntries % kBucketEntries == 0, "a segment consists of whole buckets");
  static_assert(2 * (kIndexMax / kSegmentEntries) * (kCudaTileWidth * 16) <= kIndexMax,
                "32 bits index the pixels of all segments");
  if (args.longest_whole == kAnyLength) return launch_forward_shared_memory(args, context);
  const std::int32_t n_tiles = args.blend.grid.n_tiles(), n_tasks_max = args.segments.n_tasks_max;
  cut_lists_kernel<<<1, kCutThreads, 0, context.stream>>>(args);
  B3DGS_CUDA_CHECK_LAUNCH();
  with_tile_pixels(args.blend.grid.tile, [&](auto pixels) {
    constexpr int kTilePixels = pixels.value, kBlocks = kStagedBlocks<kTilePixels>;
    static_assert(kBlocks <= kSegmentBlocks);
    forward_segmented_kernel<kTilePixels><<<kBlocks*(n_tiles + n_tasks_max), kStagedThreads, 0, context.stream>>>(args);
    B3DGS_CUDA_CHECK_LAUNCH();
    if (n_tasks_max == 0) return;
    join_segments_kernel<kTilePixels><<<n_tiles, kTilePixels, 0, context.stream>>>(args);
    B3DGS_CUDA_CHECK_LAUNCH();
    end_pixels_kernel<kTilePixels><<<kBlocks * n_tasks_max, kStagedThreads, 0, context.stream>>>(args);
    B3DGS_CUDA_CHECK_LAUNCH();
  });
}

}  // namespace b3dgs::cuda
