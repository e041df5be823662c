// Forward blend, segmented: like sub-tile, but if the longest list has much of the work (list_cut()), long lists are
// cut into segments of 128 to 512 entries that are blended in parallel. It is as balanced as combined, with the cost
// per splat of a pixel-wise kernel. The paper's balanced kernel distributes a crowded tile over its pixels instead.
//
// Compositing is associative. So a segment is blended as if the transmittance in front of it were 1, and the segments'
// (transmittance, colour) are then combined front to back. The stop at transmittance 1e-4 is not associative,
// so the segment in which a pixel finishes is blended again for that pixel, from the true transmittance.
//
//   list           |   segment 0   |   segment 1   |   segment 2   | 3 |
//   blended from   T = 1           T = 1           T = 1           T = 1     forward_segmented, in parallel
//   joined         T = 1 --------> 0.5 ----------> 0.01 ---------> finished  finish_pixels
//   blended again                                  |from T = 0.01 |          finish_pixels
//
// Kernel 1, cut_lists: one block lists the tasks, which are all segments except the first of each list, ordered by
//   their number within the list.
// Kernel 2, forward_segmented: a block per 128 pixels of a segment or whole list. The first segments of lists that are
//   at least as long as a segment start first, then the second ones, and so on, then the shorter lists. Segments behind
//   finished pixels would be wasted work. So a block first multiplies the transmittances of the segments in front that
//   are already done (a flag each, stored with release and loaded with acquire). If all its pixels are finished, it
//   marks its segment and all behind it as hidden and ends. Later blocks check this mark first. Which segments are
//   skipped depends on timing, but the image does not, because all pixels finish in front of a skipped segment.
// Kernel 3, finish_pixels: a block per 128 pixels of a task. Multiplies the transmittances in front of the segment. For
//   pixels that finish in it, or whose list ends with it, it combines the segments front to back, blends this one again
//   if necessary, and writes the pixel.
//
// Shared memory: staged splats in kernels 2 and 3 (staged_blend.cuh), counters in kernel 1.
// Barriers: one per bucket of splats, one to skip a segment, and one before it is marked as done.
// Stored for the backward pass: final transmittance, last splat, bucket parts, and the factor of each segment's parts
//   (Segments::fronts).

#include <cub/block/block_scan.cuh>
#include <cuda/atomic>

#include "raster/checks.h"
#include "raster/cuda/blend_kernels.h"
#include "raster/cuda/forward/staged_blend.cuh"
#include "raster/cuda/launch.cuh"

namespace b3dgs::cuda {
namespace {

constexpr int kCutThreads = 1024;  // one block; also the number of segment numbers that are sorted exactly

/// Lists all segments except the first of each list, sorted by their number within the list (numbers from kCutThreads -
/// 1 on in any order). This is a counting sort. Tiles are ranked by their number of segments, most first. The tiles
/// that have a segment number k are then the first n_with[k + 1] ranks, and the task of segment k of a tile is at
/// first_of_number[k] + rank.
__global__ void __launch_bounds__(kCutThreads) cut_lists_kernel(const BlendForwardCudaArgs args) {
  using BlockScan = cub::BlockScan<std::int32_t, kCutThreads>;
  constexpr std::int32_t kLast = kCutThreads - 1;  // this number and all above share a counter
  __shared__ typename BlockScan::TempStorage scan_memory;
  // Indexed by the number of segments of a tile:
  __shared__ std::int32_t next_rank[kCutThreads];  // first a count of tiles, then the next rank for such a tile
  __shared__ std::int32_t n_with[kCutThreads];     // tiles with at least that many segments
  // Indexed by a segment's number:
  __shared__ std::int32_t first_of_number[kCutThreads];  // index of the first task with that number
  __shared__ std::int32_t n_beyond;                      // number of segments with numbers from kLast on
  __shared__ std::int32_t n_long;
  const Segments& segments = args.segments;
  const auto thread = static_cast<std::int32_t>(threadIdx.x);
  const std::int32_t n_tiles = args.blend.grid.n_tiles();
  next_rank[thread] = 0;
  if (thread == 0) n_beyond = n_long = 0;
  for (std::int32_t i = thread; i < kSegmentBlocks * segments.n_max; i += kCutThreads) segments.is_done[i] = 0;
  __syncthreads();

  // Count tiles by their number of segments, and assign a range of segment indices to each list that is cut.
  std::int32_t own_long = 0;
  for (std::int32_t tile = thread; tile < n_tiles; tile += kCutThreads) {
    const std::int32_t length = list_length(args.blend.bins, tile), count = args.cut.n_segments(length);
    own_long += length >= 1 << args.cut.entries_log2;
    const std::int64_t first = args.cut.segments_before(args.blend.bins.tile_offsets[tile]);
    segments.first_of_tile[tile] = count > 1 ? static_cast<std::int32_t>(first) : -1;
    if (count > 1) atomicAdd(next_rank + min(count, kLast), 1);
    if (count > kLast) atomicAdd(&n_beyond, count - kLast);
  }
  atomicAdd(&n_long, own_long);
  __syncthreads();
  // Scan from the largest number of segments down: ranks, and the start of each segment number in the task list.
  const std::int32_t n_tiles_with = next_rank[kLast - thread];
  std::int32_t n_ranked = 0;
  BlockScan(scan_memory).InclusiveSum(n_tiles_with, n_ranked);
  n_with[kLast - thread] = n_ranked;
  next_rank[kLast - thread] = n_ranked - n_tiles_with;
  __syncthreads();
  std::int32_t n_listed = 0;
  BlockScan(scan_memory)
      .ExclusiveSum(thread > 0 && thread < kLast ? n_with[thread + 1] : 0, first_of_number[thread], n_listed);
  if (thread == 0) {
    *segments.n_tasks = n_listed + n_beyond;
    *segments.n_long = n_long;
  }
  __syncthreads();

  // Write the tasks.
  for (std::int32_t tile = thread; tile < n_tiles; tile += kCutThreads) {
    const std::int32_t count = args.cut.n_segments(list_length(args.blend.bins, tile));
    if (count == 1) continue;
    const std::int32_t end = segments.first_of_tile[tile] + count;
    const std::int32_t rank = atomicAdd(next_rank + min(count, kLast), 1);
    for (int block = 0; block < kSegmentBlocks; ++block) segments.hidden_from[kSegmentBlocks * tile + block] = end;
    for (std::int32_t k = 1; k < count; ++k) {
      segments.tasks[k < kLast ? first_of_number[k] + rank : atomicAdd(first_of_number + kLast, 1)] = {tile, k};
    }
  }
}

/// Reads task `number` of the list. Returns false if there are fewer.
__device__ __forceinline__ bool take_listed(const Segments& segments, std::int32_t number, SegmentTask& task) {
  if (number < 0 || number >= *segments.n_tasks) return false;
  task = segments.tasks[number];
  return true;
}

/// Sets the task of block `number`. First come the first segments (or whole lists) of the tiles with long lists, then
/// the listed tasks, then the other tiles. Returns false if there are fewer.
__device__ __forceinline__ bool take_segment(const BlendForwardCudaArgs& args, std::int32_t number, SegmentTask& task) {
  const std::int32_t n_long = *args.segments.n_long, n_tasks = *args.segments.n_tasks;
  if (take_listed(args.segments, number - n_long, task)) return true;
  const std::int32_t place = number < n_long ? number : number - n_tasks;
  if (place >= args.blend.grid.n_tiles()) return false;
  task = {args.tiles_by_length[place], 0};
  return true;
}

/// The segment of a task, and the pixel that this thread blends.
struct ListSegment {
  std::int32_t tile;
  std::int32_t first;  // index of the list's first segment, -1 if the list is not cut
  std::int32_t index;  // index of this segment
  int block;           // number of the block within the tile
  ListRange range;     // entries of this segment
  TilePixel at;
  __device__ ListSegment(const BlendForwardCudaArgs& args, const SegmentTask& task)
      : tile(task.tile),
        first(args.segments.first_of_tile[task.tile]),
        index(first + task.segment),
        block(static_cast<int>(blockIdx.x) % kStagedBlocks),
        at(staged_pixel(args.blend.grid, tile, block)) {
    const std::int32_t length = list_length(args.blend.bins, tile), entries = 1 << args.cut.entries_log2;
    const std::int32_t begin = task.segment << args.cut.entries_log2;
    range = {begin, first >= 0 && begin + entries < length ? begin + entries : length};
  }
  /// Returns the index of the pixel in the arrays of Segments.
  __device__ std::int32_t pixel() const { return index * kCudaTilePixels + at.index; }
};

/// Flag that becomes 1 when block `block` has blended the segment.
__device__ __forceinline__ auto is_done(const Segments& segments, std::int32_t index, int block) {
  return ::cuda::atomic_ref<std::int32_t, ::cuda::thread_scope_device>(
      segments.is_done[kSegmentBlocks * index + block]);
}

/// Returns an upper bound of the pixel's transmittance in front of this segment: the product over the segments that are
/// done. The order of the factors is that of transmittance_in_front(), so it is a bound despite rounding. Must be
/// called by all threads of a warp, including those of pixels outside the image.
__device__ __forceinline__ float transmittance_bound(const Segments& segments, const ListSegment& segment) {
  constexpr int kAtOnce = 4;  // loads in flight
  float bound = 1;
  for (std::int32_t start = segment.first; start < segment.index; start += kWarpSize) {
    const std::int32_t index = start + lane_id();
    const bool is_ready =
        index < segment.index && is_done(segments, index, segment.block).load(::cuda::memory_order_acquire) != 0;
    unsigned ready = __ballot_sync(kFullWarp, is_ready);
    __syncwarp();  // makes data that one lane acquired visible to the whole warp
    while (ready != 0) {
      float factor[kAtOnce];
#pragma unroll
      for (int k = 0; k < kAtOnce; ++k) {
        const std::int32_t from = (start + __ffs(ready) - 1) * kCudaTilePixels + segment.at.index;
        factor[k] = ready != 0 ? __ldcg(segments.transmittance + from) : 1.0f;
        ready &= ready - 1;
      }
#pragma unroll
      for (int k = 0; k < kAtOnce; ++k) bound *= factor[k] > 0 ? factor[k] : 0.0f;
    }
  }
  return bound;
}

/// Stores the result of forward_segmented_kernel. Reads the task again, because keeping it in registers during blending
/// would allow fewer blocks per multiprocessor (sm_90: 86 registers instead of 72).
__device__ __forceinline__ void store_segment(const BlendForwardCudaArgs& args, const PixelState<float>& pixel,
                                              std::int32_t last) {
  const Segments& segments = args.segments;
  SegmentTask task;
  take_segment(args, static_cast<std::int32_t>(blockIdx.x) / kStagedBlocks, task);
  const ListSegment segment(args, task);
  const bool is_first = segment.index == segment.first, is_whole = segment.first < 0;
  if (segment.at.inside && is_first && (is_whole || is_finished(pixel.transmittance))) {
    store_pixel(args.blend, segment.at, pixel, last);
  }
  if (is_whole) return;
  const std::int32_t pixel_of_segment = segment.pixel();
  if (is_first && segments.fronts != nullptr) segments.fronts[pixel_of_segment] = 1;
  segments.transmittance[pixel_of_segment] = pixel.transmittance;
  segments.color_depth[pixel_of_segment] = make_float4(pixel.red, pixel.green, pixel.blue, pixel.depth);
  segments.last[pixel_of_segment] = last;
  // Publish the segment for blocks that are behind it in the same list.
  __syncthreads();  // all threads have written
  if (threadIdx.x == 0) is_done(segments, segment.index, segment.block).store(1, ::cuda::memory_order_release);
}

__global__ void __launch_bounds__(kStagedThreads) forward_segmented_kernel(const BlendForwardCudaArgs args) {
  __shared__ StagedSplats staged;
  SegmentTask task;
  if (!take_segment(args, static_cast<std::int32_t>(blockIdx.x) / kStagedBlocks, task)) return;
  const ListSegment segment(args, task);
  // Skip a segment that cannot be visible.
  bool is_alive = segment.at.inside;
  if (segment.index > segment.first) {
    std::int32_t* const hidden_from = args.segments.hidden_from + kSegmentBlocks * segment.tile + segment.block;
    // Another block may lower it now. transmittance_bound() votes, so all lanes of a warp must see the same value.
    const bool is_hidden = segment.index >= __shfl_sync(kFullWarp, __ldcg(hidden_from), 0);
    is_alive = !is_hidden && !is_saturated(transmittance_bound(args.segments, segment)) && is_alive;
    if (__syncthreads_or(is_alive) == 0) {
      if (threadIdx.x == 0) atomicMin(hidden_from, segment.index);
      return;
    }
  }
  // Blend as if the transmittance in front were 1. Pixels outside the image or already finished start as finished.
  PixelState<float> pixel{is_alive ? 1.0f : kClosedPixel, 0, 0, 0, 0};
  const std::int32_t last = blend_staged(args, staged, segment.tile, segment.range, segment.at, pixel);
  store_segment(args, pixel, last);
}

/// Returns the transmittance of the pixel in front of a segment, or kClosedPixel if the pixel finishes before it.
__device__ __forceinline__ float transmittance_in_front(const Segments& segments, const ListSegment& segment) {
  constexpr int kAtOnce = 8;  // loads in flight
  float front = 1;
  for (std::int32_t start = segment.first; start < segment.index; start += kAtOnce) {
    float factor[kAtOnce];
#pragma unroll
    for (int k = 0; k < kAtOnce; ++k) {
      factor[k] =
          start + k < segment.index ? segments.transmittance[(start + k) * kCudaTilePixels + segment.at.index] : 1.0f;
    }
#pragma unroll
    for (int k = 0; k < kAtOnce; ++k) {
      front *= factor[k];
      if (is_saturated(front)) return kClosedPixel;
    }
  }
  return front;
}

/// Combines segments front to back up to, but not including, `end`. Returns the last splat blended, or -1.
__device__ __forceinline__ std::int32_t join_segments(const Segments& segments, std::int32_t first, std::int32_t end,
                                                      std::int32_t pixel_index, PixelState<float>& pixel) {
  std::int32_t last = -1;
#pragma unroll 4
  for (std::int32_t index = first; index < end; ++index) {
    const std::int32_t from = index * kCudaTilePixels + pixel_index;
    const float4 part = segments.color_depth[from];
    const std::int32_t last_of_segment = segments.last[from];
    const float front = pixel.transmittance;
    pixel = {front * segments.transmittance[from], pixel.red + front * part.x, pixel.green + front * part.y,
             pixel.blue + front * part.z, pixel.depth + front * part.w};
    if (last_of_segment >= 0) last = last_of_segment;
  }
  return last;
}

/// Stores the pixels that finish in a listed segment, or whose list ends with it. forward_segmented has stored those
/// that finish in the first segment. If a segment is blended again, its bucket parts are absolute instead of relative
/// to the segment.
__global__ void __launch_bounds__(kStagedThreads) finish_pixels_kernel(const BlendForwardCudaArgs args) {
  __shared__ StagedSplats staged;
  const Segments& segments = args.segments;
  SegmentTask task;
  if (!take_listed(segments, static_cast<std::int32_t>(blockIdx.x) / kStagedBlocks, task)) return;
  const ListSegment segment(args, task);
  const TilePixel& at = segment.at;
  const std::int32_t end = segments.hidden_from[kSegmentBlocks * segment.tile + segment.block];
  if (segment.index >= end) return;
  const std::int32_t pixel_of_segment = segment.pixel();
  const float front = at.inside ? transmittance_in_front(segments, segment) : kClosedPixel;
  const bool is_open = front > 0, ends = is_open && is_saturated(front * segments.transmittance[pixel_of_segment]);
  // With transmittance 1 in front, the segment was already blended correctly.
  const bool is_again = ends && front != 1;
  if (is_open && segments.fronts != nullptr) segments.fronts[pixel_of_segment] = is_again ? 1 : front;

  PixelState<float> pixel{1, 0, 0, 0, 0};
  std::int32_t last = -1;
  if (ends || (is_open && segment.index + 1 == end)) {
    last = join_segments(segments, segment.first, is_again ? segment.index : segment.index + 1, at.index, pixel);
    if (!is_again) store_pixel(args.blend, at, pixel, last);
  }
  if (__syncthreads_or(is_again) == 0) return;
  if (!is_again) pixel.transmittance = kClosedPixel;
  const std::int32_t last_again = blend_staged(args, staged, segment.tile, segment.range, at, pixel);
  if (is_again) store_pixel(args.blend, at, pixel, last_again >= 0 ? last_again : last);
}

}  // namespace

void launch_forward_segmented(const BlendForwardCudaArgs& args, const LaunchContext& context) {
  static_assert(1 << ListCut::kMinLog2 == kBucketEntries, "a segment consists of whole buckets");
  static_assert(3 * (std::int64_t{kIndexMax} >> (ListCut::kMaxLog2 + 1)) * kCudaTilePixels <= kIndexMax,
                "32 bits index the pixels of all segments, which are shorter only if there are few");
  if (!args.cut.cuts()) return launch_forward_sub_tile(args, context);
  const std::int32_t n_tiles = args.blend.grid.n_tiles(), n_tasks_max = args.segments.n_tasks_max;
  static_assert(kStagedBlocks == kSegmentBlocks);
  launch_blocks(cut_lists_kernel, 1, kCutThreads, context, args);
  launch_blocks(forward_segmented_kernel, kStagedBlocks * (n_tiles + n_tasks_max), kStagedThreads, context, args);
  launch_blocks(finish_pixels_kernel, kStagedBlocks * n_tasks_max, kStagedThreads, context, args);
}

}  // namespace b3dgs::cuda
