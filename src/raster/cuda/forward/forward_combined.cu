// Forward blend, combined: the paper's fine-grained combined load balancing.
//
// Kernel 1, mark_quads: which quads (2 x 2 pixels) does each list entry touch? This kernel is not in the paper. A pixel
// sees few splats of a crowded list; with the marks, a task fetches only those that touch its quad.
//   Warp: a run of 32 entries of a tile's list, a quarter of a bucket. Lane: an entry; it finds the quads that its
//   splat's ellipse touches,
//     a bit each. A bit transposition across the warp turns this into a mask per quad, with a bit per entry.
//
// Kernel 2, forward_combined: blends the quads. A crowded tile becomes 64 tasks, so no block works longer than one
// quad takes.
//   Grid: as many blocks of 4 warps as are resident at once; they take quads from an atomic counter.
//   Block: a quad. Warp: one of its four pixels.
//
//        list of the tile            candidates            queue of each pixel         pixel
//     |.x...x..|x......x|    scan     | x x x x |  evaluate    | x x x  |    blend      (sum)
//      1024 pairs at a time  ---->   that touch     ---->      | x x    |    ---->       one
//      x: the pair's splat           the quad,                 | x x x x|   32 at a    a warp
//         touches the quad         128 at a time               |        |    time
//
//   Repeated until the list ends or all four pixels are finished:
//     1. Scan: the block reads the quad's masks for 1024 entries and appends the marked entries to `candidates`.
//     2. Evaluate: 128 candidates at a time, one per thread, each at all four pixel centres. A candidate is appended
//        to the queues of the pixels that it contributes to, in list order. A queue is a ring in shared memory.
//     3. Blend: each warp blends full groups of 32 splats from its pixel's queue, a lane per splat, with a prefix
//        product for the transmittances (gaussian_wise.cuh). Up to 31 splats stay queued until more are appended.
//   Shared memory: candidates, four queues and counts (QuadMemory, about 20 KB); two tickets of the task counter.
//   Barriers: two per scan, two per evaluation, and one at the end of a task, after which the next task is known and
//     QuadMemory may be overwritten.
//   Saved for the backward pass: final transmittance, last splat, and bucket parts (BucketParts).

#include "raster/cuda/blend_kernels.h"
#include "raster/cuda/forward/gaussian_wise.cuh"
#include "raster/cuda/launch.cuh"

namespace b3dgs::cuda {
namespace {

constexpr int kPixels = kQuadPixels;           // pixels and warps of a block
constexpr int kThreads = kPixels * kWarpSize;  // 128
// Capacity of a pixel's queue: at most 31 splats are left before an evaluation, which adds at most one per thread.
constexpr int kRing = kWarpSize + kThreads;
static_assert(kRing % kWarpSize == 0, "a group of 32 never wraps around the end of the ring");
constexpr int kScanBits = 8;                    // entries that a thread scans at once: a quarter of a mask
constexpr int kScanned = kScanBits * kThreads;  // 1024 entries that a block scans at once
constexpr int kThreadsPerMask = 32 / kScanBits;
static_assert(kScanned % kWarpSize == 0, "a scan covers whole masks");
// Counts of up to 128 contributions are packed into a byte per pixel and added as one number.
static_assert(kPixels == 4 && kThreads <= 0xff, "four bytes of a word, one per pixel");
constexpr int kMarkWarps = 8;  // per block of mark_quads_kernel

/// Quads of a row of a tile, and of a tile.
constexpr int kRowQuads = kCudaTileSide / kQuadSide, kTileQuads = kCudaTilePixels / kPixels;
static_assert(kTileQuads % kWarpSize == 0, "mark_quads_kernel handles 32 quads at a time");

/// Which of 32 quads (4 rows of quads of a tile, from column x and row y of the image's quads on) a splat touches: a
/// bit each, row by row.
__device__ __forceinline__ std::uint32_t touched_quads(const TileGrid& quads, const TileRows& rows, std::int32_t x,
                                                       std::int32_t y) {
  std::uint32_t touched = 0;
#pragma unroll
  for (std::int32_t row = 0; row < kWarpSize / kRowQuads; ++row) {
    if (y + row < rows.begin || y + row >= rows.end) continue;
    const Span span = rows.span(quads, y + row);
    const std::int32_t begin = max(span.begin - x, 0), end = min(span.end - x, kRowQuads);
    if (begin < end) touched |= ((1u << end) - (1u << begin)) << (row * kRowQuads);
  }
  return touched;
}

/// Writes, for each run of 32 entries and each quad of its tile, a mask that tells which of the 32 splats touch the
/// quad. A tile's masks are stored quad by quad, so that a task reads contiguous masks.
__global__ void __launch_bounds__(kMarkWarps* kWarpSize) mark_quads_kernel(const BlendForwardCudaArgs args) {
  const BlendForwardArgs& blend = args.blend;
  const std::int64_t task = static_cast<std::int64_t>(blockIdx.x) * kMarkWarps + threadIdx.x / kWarpSize;
  const std::int64_t bucket = task / kMasksPerBucket;
  if (bucket >= args.buckets.n) return;
  const std::int32_t tile = args.buckets.tile_of_bucket[bucket];
  const std::int64_t begin = blend.bins.tile_offsets[tile], end = blend.bins.tile_offsets[tile + 1];
  const std::int64_t first = args.buckets.offsets[tile] * kMasksPerBucket, run = task - first;
  const std::int64_t n_runs = (end - begin + kWarpSize - 1) / kWarpSize, entry = begin + run * kWarpSize + lane_id();
  if (run >= n_runs) return;
  const TileGrid quads = make_tile_grid(blend.grid.image_width, blend.grid.image_height, {kQuadSide, kQuadSide});
  // The splat's ellipse, tiled by quads. No rows beyond the end of the list.
  TileRows rows{};
  if (entry < end) {
    const std::int32_t id = blend.bins.splat_ids[entry];
    const float4 mean = load_mean(blend.splats, id), conic = load_conic(blend.splats, id);
    const Splat splat{mean.x, mean.y, mean.z, mean.w, conic.x, conic.y, conic.z, 0, 0, 0, 0, 0};
    // Below opacity 1/255 a splat contributes nowhere, and its ellipse is not defined (Culling::kSquare lists it).
    if (mean.z >= kLog2AlphaMin) rows = tile_rows(quads, Culling::kEllipse, splat, blend.extents[id], 0);
  }
  const std::int32_t x = tile % blend.grid.columns * kRowQuads, y = tile / blend.grid.columns * kRowQuads;
  std::uint32_t* const masks = args.quad_masks + first * kTileQuads + run;
#pragma unroll
  for (int quad = 0; quad < kTileQuads; quad += kWarpSize) {
    const std::uint32_t touched = touched_quads(quads, rows, x, y + quad / kRowQuads);
    masks[(quad + lane_id()) * n_runs] = warp_transpose(touched);
  }
}

/// Shared memory of a block while it works on a quad.
struct QuadMemory {
  std::int32_t candidates[kThreads + kScanned];  // positions in the tile's list of splats that touch the quad
  // The queue of each pixel: splats that contribute to it and are not blended yet.
  float4 color_depth[kPixels][kRing];  // red, green, blue, depth
  float power[kPixels][kRing];         // log2 of the uncapped alpha
  std::int32_t position[kPixels][kRing];
  std::uint32_t n_by_warp[kPixels];  // scan: a count; evaluate: four counts, a byte per pixel
};

/// `index` modulo kRing, for an index below 2 kRing.
__device__ __forceinline__ int wrapped(int index) {
  return index < kRing ? index : index - kRing;
}

/// Byte `index` of a word of four counts.
__device__ __forceinline__ int byte_of(std::uint32_t bytes, int index) {
  return static_cast<int>(bytes >> (8 * index) & 0xffu);
}

/// One task: a quad, blended by the whole block.
template <StoredParts kStored>
class QuadBlend {
 public:
  /// `quad`: number of the quad in the tile; (x, y): its upper left pixel in the image.
  __device__ __forceinline__ QuadBlend(const BlendForwardCudaArgs& args, std::int32_t tile, std::int32_t quad,
                                       std::int32_t x, std::int32_t y, const TilePixel& at, QuadMemory& shared)
      : splats_(args.blend.splats),
        ids_(args.blend.bins.splat_ids + args.blend.bins.tile_offsets[tile]),
        n_runs_((list_length(args.blend.bins, tile) + kWarpSize - 1) / kWarpSize),
        masks_(args.quad_masks + args.buckets.offsets[tile] * kMasksPerBucket * kTileQuads +
               static_cast<std::int64_t>(quad) * n_runs_),
        center_x_(static_cast<float>(x) + 0.5f),
        center_y_(static_cast<float>(y) + 0.5f),
        shared_(shared),
        pixel_(args, tile, at),
        is_done_(!at.inside) {}

  __device__ __forceinline__ void run() {
    // The mask with this thread's byte, loaded one scan ahead.
    const std::int32_t run = thread_ / kThreadsPerMask;
    std::uint32_t next_mask = run < n_runs_ ? __ldg(masks_ + run) : 0;
    bool all_done = false;
    for (std::int32_t start = 0; start < n_runs_ && !all_done; start += kScanned / kWarpSize) {
      const unsigned marks = next_mask >> (thread_ % kThreadsPerMask * kScanBits) & 0xffu;
      const std::int32_t next_run = start + kScanned / kWarpSize + run;
      next_mask = next_run < n_runs_ ? __ldg(masks_ + next_run) : 0;
      scan(marks, start * kWarpSize + thread_ * kScanBits);
      __syncthreads();  // candidates are complete

      // Evaluate and blend full groups of 128 candidates. After the last scan, also the rest.
      const int wanted = start + kScanned / kWarpSize < n_runs_ ? kThreads : 1;
      int taken = 0;
      for (; n_candidates_ - taken >= wanted && !all_done; taken += kThreads) {
        const int added = evaluate(taken + thread_);
        all_done = added < 0;
        n_queued_ += added;
        for (; n_queued_ >= kWarpSize && !is_done_; n_queued_ -= kWarpSize) {
          blend(kWarpSize);
          head_ = wrapped(head_ + kWarpSize);
          is_done_ = pixel_.is_finished();
        }
      }
      // Move the remaining candidates to the front. Unless all_done, fewer than kThreads are left, so source and
      // destination do not overlap. All reads of what is overwritten happened before the last barrier.
      const int n_left = max(n_candidates_ - taken, 0);
      if (taken > 0 && thread_ < n_left) shared_.candidates[thread_] = shared_.candidates[taken + thread_];
      n_candidates_ = n_left;
    }
  }

  /// Blends what is still queued and writes the pixel, which must be inside the image. No barriers.
  __device__ __forceinline__ void finish() {
    if (n_queued_ > 0 && !is_done_) blend(n_queued_);
    pixel_.store();
  }

 private:
  /// Appends the positions of the marked entries among the next kScanned to the candidates. Bit b of `marks` tells
  /// whether entry position + b touches the quad. One barrier inside; another must follow before the new candidates are
  /// read.
  __device__ __forceinline__ void scan(unsigned marks, std::int32_t position) {
    const int n_marked = __popc(marks), n_up_to_lane = warp_prefix(n_marked, [](int a, int b) { return a + b; });
    if (lane_id() == kWarpSize - 1) shared_.n_by_warp[warp_] = static_cast<std::uint32_t>(n_up_to_lane);
    __syncthreads();  // counts of all warps
    int index = n_candidates_ + n_up_to_lane - n_marked;
#pragma unroll
    for (int w = 0; w < kPixels; ++w) {
      const int n_in_warp = static_cast<int>(shared_.n_by_warp[w]);
      if (w < warp_) index += n_in_warp;
      n_candidates_ += n_in_warp;
    }
    for (; marks != 0; marks &= marks - 1) shared_.candidates[index++] = position + __ffs(marks) - 1;
  }

  /// Each thread that has a candidate evaluates it at the four pixels and appends it to the queues of those it
  /// contributes to. Two barriers inside: after the first, all warps have finished reading their queues; after the
  /// second, the queues are filled. Returns how many were appended to this warp's queue; -1 if all four pixels are
  /// finished: nothing was appended, and no queue is read any more.
  __device__ __forceinline__ int evaluate(int candidate) {
    const int lane = lane_id();
    const bool has_candidate = candidate < n_candidates_;
    std::int32_t position = 0;
    float4 mean{}, conic{}, color{};
    if (has_candidate) {
      position = shared_.candidates[candidate];
      const std::int32_t id = __ldg(ids_ + position);
      mean = load_mean(splats_, id), conic = load_conic(splats_, id), color = load_color(splats_, id);
    }
    const SplatShape<float> shape = make_splat_shape(mean, conic);
    float power[kPixels];
    unsigned contributing[kPixels];  // lanes whose splat contributes to each pixel
    std::uint32_t warp_counts = 0;   // how many, a byte per pixel
#pragma unroll
    for (int p = 0; p < kPixels; ++p) {
      const Footprint<float> footprint = evaluate_footprint(shape, center_x_ + static_cast<float>(p % kQuadSide),
                                                            center_y_ + static_cast<float>(p / kQuadSide));
      power[p] = footprint.power;
      contributing[p] = __ballot_sync(kFullWarp, footprint.contributes && has_candidate);
      warp_counts |= static_cast<std::uint32_t>(__popc(contributing[p])) << (8 * p);
    }
    if (lane == 0) shared_.n_by_warp[warp_] = warp_counts;
    // Counts are written, and all warps have finished reading their queues.
    if (__syncthreads_and(is_done_)) return -1;
    // Counts of the warps ahead of this one, and of all; four bytes are added as one number.
    std::uint32_t ahead = 0, all = 0;
#pragma unroll
    for (int w = 0; w < kPixels; ++w) {
      const std::uint32_t counts = shared_.n_by_warp[w];
      if (w < warp_) ahead += counts;
      all += counts;
    }
#pragma unroll
    for (int p = 0; p < kPixels; ++p) {
      // List order is thread order: append behind the warps ahead and the lower lanes.
      if ((contributing[p] >> lane & 1) != 0) {
        const int n_before = byte_of(ahead, p) + __popc(contributing[p] & ((1u << lane) - 1));
        const int index = wrapped(ends_[p] + n_before);
        shared_.color_depth[p][index] = make_float4(color.x, color.y, color.z, mean.w);
        shared_.power[p][index] = power[p];
        shared_.position[p][index] = position;
      }
      ends_[p] = wrapped(ends_[p] + byte_of(all, p));
    }
    __syncthreads();  // the queues are filled
    return byte_of(all, warp_);
  }

  /// The warp blends the first `count` <= 32 splats of its queue.
  __device__ __forceinline__ void blend(int count) {
    const int index = head_ + lane_id();
    pixel_.blend({lane_id() < count, shared_.power[warp_][index], shared_.position[warp_][index]},
                 [&] { return shared_.color_depth[warp_][index]; });
  }

  const Splat* const splats_;
  const std::int32_t* const ids_;  // the tile's list
  const std::int32_t n_runs_;      // of 32 entries
  const std::uint32_t* const masks_;
  const float center_x_, center_y_;  // pixel centre of the quad's upper left pixel
  QuadMemory& shared_;
  const int thread_ = static_cast<int>(threadIdx.x), warp_ = thread_ / kWarpSize;
  GaussianWisePixel<kStored> pixel_;
  bool is_done_;
  int n_candidates_ = 0;
  // Where the next splat is appended to each queue, below kRing; the same in all threads.
  int ends_[kPixels] = {};
  // This warp's queue. The head is a multiple of 32, as is kRing, so a group of 32 never wraps around.
  int head_ = 0, n_queued_ = 0;
};

/// One task, by the whole block.
template <StoredParts kStored>
__device__ __forceinline__ void blend_quad(const BlendForwardCudaArgs& args, std::int32_t task, QuadMemory& shared) {
  const TileGrid& grid = args.blend.grid;
  const std::int32_t tile = task / kTileQuads, quad = task % kTileQuads;
  const std::int32_t warp = static_cast<std::int32_t>(threadIdx.x) / kWarpSize;
  // The quad's upper left pixel within the tile, and the tile's within the image.
  const std::int32_t quad_x = quad % kRowQuads * kQuadSide, quad_y = quad / kRowQuads * kQuadSide;
  const std::int32_t tile_x = tile % grid.columns * kCudaTileSide, tile_y = tile / grid.columns * kCudaTileSide;
  if (tile_x + quad_x >= grid.image_width || tile_y + quad_y >= grid.image_height) return;
  const std::int32_t x = quad_x + warp % kQuadSide, y = quad_y + warp / kQuadSide;
  const TilePixel at{tile_x + x, tile_y + y, y * kCudaTileSide + x,
                     tile_x + x < grid.image_width && tile_y + y < grid.image_height};
  QuadBlend<kStored> blend(args, tile, quad, tile_x + quad_x, tile_y + quad_y, at, shared);
  blend.run();
  if (at.inside) blend.finish();
}

template <StoredParts kStored>
__global__ void __launch_bounds__(kThreads)
    forward_combined_kernel(const BlendForwardCudaArgs args, const std::int32_t n_tasks) {
  __shared__ QuadMemory shared;
  __shared__ std::int32_t tickets[2];
  // The first task is the block's own index. Each further one is requested while the task before is blended, so that no
  // block waits for the atomic; two tickets alternate, because one may still be read when the next is written.
  auto task = static_cast<std::int32_t>(blockIdx.x);
  for (int turn = 0; task < n_tasks; turn ^= 1) {
    std::int32_t upcoming = 0;
    if (threadIdx.x == 0) upcoming = static_cast<std::int32_t>(gridDim.x) + atomicAdd(args.next_task, 1);
    blend_quad<kStored>(args, task, shared);
    if (threadIdx.x == 0) tickets[turn] = upcoming;
    __syncthreads();  // the ticket is written, and QuadMemory may be overwritten
    task = tickets[turn];
  }
}

}  // namespace

void launch_forward_combined(const BlendForwardCudaArgs& args, const LaunchContext& context) {
  const std::int64_t n_tasks = std::int64_t{kTileQuads} * args.blend.grid.n_tiles();
  B3DGS_CHECK(n_tasks < std::int64_t{1} << 30, "image too large for the combined kernel: ", n_tasks,
              " tasks, expected below 2^30");
  launch_blocks(mark_quads_kernel, n_blocks(args.buckets.n * kMasksPerBucket, kMarkWarps), kMarkWarps * kWarpSize,
                context, args);
  reset_tasks(args.next_task, context);
  with_stored_parts(args.parts, [&](auto stored) {
    const auto kernel = forward_combined_kernel<stored.value>;
    launch_blocks(kernel, resident_blocks(kernel, kThreads, context), kThreads, context, args,
                  static_cast<std::int32_t>(n_tasks));
  });
}

}  // namespace b3dgs::cuda
