// Forward blend, segmented: long lists are cut into segments of equal length, and a block owns a segment of a tile's
// list, a thread a pixel, as in shared-memory. Balanced as combined is, with the work of a pixel-wise kernel.
//
// Beyond the paper, whose balanced kernel spreads a crowded tile over its pixels: compositing is associative, so that
// the list itself can be divided. A segment is blended as if all light reached it; (transmittance, colour) of the
// segments are then joined front to back. What does not divide is where a pixel ends: the segment whose splats would
// take its transmittance below the minimum is blended once more for that pixel, from what reaches it.
//
// Segments behind that one are work in vain. So that there is little of it, blocks begin with the first segments of all
// lists, then take the second ones, and so on; and a block whose turn has come looks at which segments before its own
// are done by now, and leaves its own alone if no light comes through them. What it finds there depends on who was
// first, but no pixel does: a segment that is left alone lies behind the end of every pixel.
//
// Four kernels: cut the lists; blend; join; blend the segments in which pixels end.

#include <cub/block/block_scan.cuh>
#include <cuda/atomic>

#include "raster/args_check.h"
#include "raster/cuda/forward/forward_table.h"
#include "raster/cuda/forward/staged_blend.cuh"
#include "raster/cuda/launch.cuh"

namespace b3dgs::cuda {
namespace {

constexpr int kCutThreads = 1024;

__device__ __forceinline__ std::int32_t n_segments(std::int32_t length) {
  return length > kSegmentEntries ? (length + kSegmentEntries - 1) / kSegmentEntries : 1;
}

/// One block lists the segments after the first ones in the order of their numbers; from kCutThreads - 1 on in any
/// order. Tiles are ranked by how many segments they have: those with a segment of some number are then the first ones.
__global__ void __launch_bounds__(kCutThreads) cut_lists_kernel(const BlendForwardCudaArgs args) {
  using BlockScan = cub::BlockScan<std::int32_t, kCutThreads>;
  constexpr std::int32_t kLast = kCutThreads - 1;  // stands for this number and all beyond
  __shared__ typename BlockScan::TempStorage scan_memory;
  __shared__ std::int32_t next_rank[kCutThreads];        // of tiles with so many segments
  __shared__ std::int32_t n_with[kCutThreads];           // tiles with so many segments or more
  __shared__ std::int32_t first_of_number[kCutThreads];  // place in the list of tasks
  __shared__ std::int32_t n_beyond;                      // segments of numbers from kLast on
  const Segments& segments = args.segments;
  const auto thread = static_cast<std::int32_t>(threadIdx.x);
  const std::int32_t n_tiles = args.blend.grid.n_tiles();
  next_rank[thread] = 0;
  if (thread == 0) n_beyond = 0;
  __syncthreads();

  for (std::int32_t tile = thread; tile < n_tiles; tile += kCutThreads) {
    const std::int32_t count = n_segments(list_length(args.blend.bins, tile));
    // Two segments or more have at least half as many entries as they have room for: so numbers leave enough of it.
    segments.first_of_tile[tile] =
        count > 1 ? static_cast<std::int32_t>(2 * args.blend.bins.tile_offsets[tile] / kSegmentEntries) : -1;
    if (count > 1) atomicAdd(next_rank + min(count, kLast), 1);
    if (count > kLast) atomicAdd(&n_beyond, count - kLast);
  }
  __syncthreads();
  const std::int32_t own_tiles = next_rank[kLast - thread];
  std::int32_t n_ranked = 0;
  BlockScan(scan_memory).InclusiveSum(own_tiles, n_ranked);
  n_with[kLast - thread] = n_ranked;
  next_rank[kLast - thread] = n_ranked - own_tiles;
  __syncthreads();
  std::int32_t n_listed = 0;
  BlockScan(scan_memory)
      .ExclusiveSum(thread > 0 && thread < kLast ? n_with[thread + 1] : 0, first_of_number[thread], n_listed);
  if (thread == 0) *segments.n_tasks = n_listed + n_beyond;
  __syncthreads();

  for (std::int32_t tile = thread; tile < n_tiles; tile += kCutThreads) {
    const std::int32_t count = n_segments(list_length(args.blend.bins, tile));
    if (count == 1) continue;
    const std::int32_t first = segments.first_of_tile[tile], rank = atomicAdd(next_rank + min(count, kLast), 1);
    segments.is_done[first] = 0;
    for (std::int32_t k = 1; k < count; ++k) {
      segments.is_done[first + k] = 0;
      segments.tasks[k < kLast ? first_of_number[k] + rank : atomicAdd(first_of_number + kLast, 1)] = {tile, k};
    }
  }
}

/// A listed task; false if there are not so many.
__device__ __forceinline__ bool take_listed(const Segments& segments, std::int32_t number, SegmentTask& task) {
  if (number >= *segments.n_tasks) return false;
  task = segments.tasks[number];
  return true;
}

/// The block's task: the first blocks take each tile's list or its first segment, those after them what is listed.
__device__ __forceinline__ bool take_segment(const BlendForwardCudaArgs& args, SegmentTask& task) {
  const auto block = static_cast<std::int32_t>(blockIdx.x), n_tiles = args.blend.grid.n_tiles();
  task = {block, 0};
  return block < n_tiles || take_listed(args.segments, block - n_tiles, task);
}

/// Where a task's segment lies.
struct OwnSegment {
  std::int32_t tile, first, index;  // of the tile's first segment and of the own one; first is -1 for a whole list
  ListRange range;
  __device__ OwnSegment(const BlendForwardCudaArgs& args, const SegmentTask& task)
      : tile(task.tile), first(args.segments.first_of_tile[task.tile]), index(first + task.segment) {
    const std::int32_t length = list_length(args.blend.bins, tile), begin = task.segment * kSegmentEntries;
    range = {begin, first >= 0 && begin + kSegmentEntries < length ? begin + kSegmentEntries : length};
  }
};

/// Upper bound on what comes through the pixel's segments before the own one: the product of those that are done, in
/// the order in which they are joined, so that rounding keeps it a bound. For all threads of the block, those of pixels
/// outside the image too.
template <int kThreads>
__device__ __forceinline__ float light_so_far(const Segments& segments, const OwnSegment& own,
                                              std::int32_t pixel_index) {
  constexpr int kAtOnce = 4;  // loads on their way
  float light = 1;
  for (std::int32_t start = own.first; start < own.index; start += kWarpSize) {
    const std::int32_t segment = start + lane_id();
    bool is_done = false;
    if (segment < own.index) {
      ::cuda::atomic_ref<std::int32_t, ::cuda::thread_scope_device> done(segments.is_done[segment]);
      is_done = done.load(::cuda::memory_order_acquire) != 0;
    }
    unsigned ready = __ballot_sync(kFullWarp, is_done);
    __syncwarp();  // what a lane has acquired, all lanes may read
    while (ready != 0) {
      float factor[kAtOnce];
#pragma unroll
      for (int k = 0; k < kAtOnce; ++k) {
        const std::int32_t from = (start + __ffs(ready) - 1) * kThreads + pixel_index;
        factor[k] = ready != 0 ? __ldcg(segments.transmittance + from) : 1.0f;
        ready &= ready - 1;
      }
#pragma unroll
      for (int k = 0; k < kAtOnce; ++k) light *= factor[k] > 0 ? factor[k] : 0.0f;
    }
  }
  return light;
}

template <int kThreads>
__global__ void __launch_bounds__(kThreads) forward_segmented_kernel(const BlendForwardCudaArgs args) {
  __shared__ BatchPair<kThreads> batches;
  const BlendForwardArgs& blend = args.blend;
  const Segments& segments = args.segments;
  SegmentTask task;
  if (!take_segment(args, task)) return;
  const OwnSegment own(args, task);
  const TilePixel at = staged_pixel(blend.grid, own.tile);
  const std::int32_t pixel_of_segment = own.index * kThreads + at.index;
  bool is_lit = at.inside, is_any_lit = true;
  if (own.index > own.first) {
    segments.before[pixel_of_segment] = 1;
    const float light = light_so_far<kThreads>(segments, own, at.index);  // its votes need all lanes
    is_lit = is_lit && light >= kTransmittanceMin;
    is_any_lit = __syncthreads_or(is_lit) != 0;
  }

  // Outside the image, or behind the pixel's end: finished.
  PixelState<float> pixel{is_lit ? 1.0f : -1.0f, 0, 0, 0, 0};
  const std::int32_t last = is_any_lit ? blend_staged(args, batches, own.tile, own.range, at, pixel) : -1;
  if (own.first < 0) {
    if (at.inside) store_pixel(blend, at, pixel, last);
    return;
  }
  segments.transmittance[pixel_of_segment] = pixel.transmittance;
  segments.shown[pixel_of_segment] = make_float4(pixel.red, pixel.green, pixel.blue, pixel.depth);
  segments.last[pixel_of_segment] = last;
  __syncthreads();  // all threads have written
  if (threadIdx.x == 0) {
    ::cuda::atomic_ref<std::int32_t, ::cuda::thread_scope_device> done(segments.is_done[own.index]);
    done.store(1, ::cuda::memory_order_release);
  }
}

/// A pixel's segments front to back, to the one in which the pixel ends. There end_pixels_kernel goes on: it finds what
/// was blended so far in the segment's `shown` and `last`, and the negated transmittance in `before`.
template <int kThreads>
__global__ void __launch_bounds__(kThreads) join_segments_kernel(const BlendForwardCudaArgs args) {
  constexpr int kAtOnce = 8;  // loads on their way
  const Segments& segments = args.segments;
  const auto tile = static_cast<std::int32_t>(blockIdx.x);
  const std::int32_t first = segments.first_of_tile[tile];
  if (first < 0) return;
  const TilePixel at = tile_pixel(args.blend.grid, tile, static_cast<std::int32_t>(threadIdx.x));
  if (!at.inside) {
    segments.before[first * kThreads + at.index] = 1;
    return;
  }

  const std::int32_t count = n_segments(list_length(args.blend.bins, tile));
  PixelState<float> pixel{1, 0, 0, 0, 0};
  std::int32_t last = -1;
  for (std::int32_t start = 0; start < count; start += kAtOnce) {
    const std::int32_t own = (first + start) * kThreads + at.index;
    float transmittance[kAtOnce];
    float4 shown[kAtOnce];
    std::int32_t last_of_segment[kAtOnce];
#pragma unroll
    for (int k = 0; k < kAtOnce; ++k) {
      const std::int32_t from = own + (start + k < count ? k : 0) * kThreads;
      transmittance[k] = segments.transmittance[from];
      shown[k] = segments.shown[from];
      last_of_segment[k] = segments.last[from];
    }
#pragma unroll
    for (int k = 0; k < kAtOnce; ++k) {
      if (start + k >= count) break;
      const std::int32_t to = own + k * kThreads;
      const float before = pixel.transmittance, behind = before * transmittance[k];
      const bool is_exact = before == 1;              // the segment was blended from what does reach it
      if (behind < kTransmittanceMin && !is_exact) {  // or negative: the segment alone ends the pixel
        segments.before[to] = -before;
        segments.shown[to] = make_float4(pixel.red, pixel.green, pixel.blue, pixel.depth);
        segments.last[to] = last;
        return;
      }
      segments.before[to] = before;
      pixel = {behind, pixel.red + before * shown[k].x, pixel.green + before * shown[k].y,
               pixel.blue + before * shown[k].z, pixel.depth + before * shown[k].w};
      if (last_of_segment[k] >= 0) last = last_of_segment[k];
      if (behind < 0) {
        store_pixel(args.blend, at, pixel, last);
        return;
      }
    }
  }
  store_pixel(args.blend, at, pixel, last);
}

/// The segments in which pixels end, for these pixels. What is kept of their buckets is then absolute, so that `before`
/// becomes 1.
template <int kThreads>
__global__ void __launch_bounds__(kThreads) end_pixels_kernel(const BlendForwardCudaArgs args) {
  __shared__ BatchPair<kThreads> batches;
  const Segments& segments = args.segments;
  SegmentTask task;
  // No pixel ends in the first segment of its list that has not been blended as it should.
  if (!take_listed(segments, static_cast<std::int32_t>(blockIdx.x), task)) return;
  const OwnSegment own(args, task);
  const TilePixel at = staged_pixel(args.blend.grid, own.tile);
  const std::int32_t pixel_of_segment = own.index * kThreads + at.index;
  const float before = segments.before[pixel_of_segment];
  const bool ends = before < 0;
  if (__syncthreads_or(ends) == 0) return;

  PixelState<float> pixel{-1, 0, 0, 0, 0};
  if (ends) {
    const float4 shown = segments.shown[pixel_of_segment];
    pixel = {-before, shown.x, shown.y, shown.z, shown.w};
  }
  const std::int32_t last = blend_staged(args, batches, own.tile, own.range, at, pixel);
  if (!ends) return;
  store_pixel(args.blend, at, pixel, last >= 0 ? last : segments.last[pixel_of_segment]);
  segments.before[pixel_of_segment] = 1;
}

}  // namespace

void launch_forward_segmented(const BlendForwardCudaArgs& args, const LaunchContext& context) {
  static_assert(kSegmentEntries % kWarpSize == 0, "segments begin with a bucket");
  static_assert(2 * (kIndexMax / kSegmentEntries) * 256 <= kIndexMax, "32 bits count the pixels of all segments");
  const std::int32_t n_tiles = args.blend.grid.n_tiles(), n_tasks_max = args.segments.n_tasks_max;
  cut_lists_kernel<<<1, kCutThreads, 0, context.stream>>>(args);
  B3DGS_CUDA_CHECK_LAUNCH();
  with_tile_pixels(args.blend.grid.tile, [&](auto pixels) {
    constexpr int kThreads = pixels.value;
    forward_segmented_kernel<kThreads><<<n_tiles + n_tasks_max, kThreads, 0, context.stream>>>(args);
    B3DGS_CUDA_CHECK_LAUNCH();
    if (n_tasks_max == 0) return;
    join_segments_kernel<kThreads><<<n_tiles, kThreads, 0, context.stream>>>(args);
    B3DGS_CUDA_CHECK_LAUNCH();
    end_pixels_kernel<kThreads><<<n_tasks_max, kThreads, 0, context.stream>>>(args);
    B3DGS_CUDA_CHECK_LAUNCH();
  });
}

KernelResources forward_segmented_resources(const TileShape& tile) {
  KernelResources resources;
  with_tile_pixels(
      tile, [&](auto pixels) { resources = kernel_resources(forward_segmented_kernel<pixels.value>, pixels.value); });
  return resources;
}

}  // namespace b3dgs::cuda
