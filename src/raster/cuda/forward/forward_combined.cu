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

constexpr TileShape kQuadShape{kQuadSide, kQuadSide};

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
  // The splat's ellipse, tiled by quads. No rows beyond the end of the list.
  TileRows rows{};
  if (entry < end) {
    const std::int32_t id = blend.bins.splat_ids[entry];
    const float4 mean = load_mean(blend.splats, id).v, conic = load_conic(blend.splats, id).v;
    const Splat splat{mean.x, mean.y, mean.z, mean.w, conic.x, conic.y, conic.z, 0, 0, 0, 0, 0};
    // Below opacity 1/255 a splat contributes nowhere, and its ellipse is not defined (Culling::kSquare lists it).
    if (mean.z >= kLog2AlphaMin) {
      rows = tile_rows(make_tile_grid(blend.grid.image_width, blend.grid.image_height, kQuadShape), Culling::kEllipse,
                       splat, blend.extents[id], 0);
    }
  }
  const TileGrid quads = make_tile_grid(blend.grid.image_width, blend.grid.image_height, kQuadShape);
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

/// Scan: appends the positions of the marked entries among the next kScanned to `candidates`. Bit b of `marks` tells
/// whether entry position + b touches the quad. One barrier inside; the caller needs another one before it reads the
/// new candidates. Returns the total number of candidates.
__device__ __forceinline__ int add_candidates(QuadMemory& shared, int n_candidates, unsigned marks,
                                              std::int32_t position) {
  const int warp = static_cast<int>(threadIdx.x) / kWarpSize;
  const int n_marked = __popc(marks), n_up_to_lane = warp_prefix_sum(n_marked);
  if (lane_id() == kWarpSize - 1) shared.n_by_warp[warp] = static_cast<std::uint32_t>(n_up_to_lane);
  __syncthreads();  // counts of all warps
  int index = n_candidates + n_up_to_lane - n_marked;
#pragma unroll
  for (int w = 0; w < kPixels; ++w) {
    const int n_in_warp = static_cast<int>(shared.n_by_warp[w]);
    if (w < warp) index += n_in_warp;
    n_candidates += n_in_warp;
  }
  for (; marks != 0; marks &= marks - 1) shared.candidates[index++] = position + __ffs(marks) - 1;
  return n_candidates;
}

/// Byte `index` of a word of four counts.
__device__ __forceinline__ int byte_of(std::uint32_t bytes, int index) {
  return static_cast<int>(bytes >> (8 * index) & 0xffu);
}

/// The quad of a task.
struct Quad {
  const Splat* splats;
  const std::int32_t* ids;   // its tile's list
  float center_x, center_y;  // pixel centre of its upper left pixel
};

/// Where the next splat is appended to each queue, below kRing; the same in all threads.
struct QueueEnds {
  int of_pixel[kPixels] = {0, 0, 0, 0};
};

/// The queue of a warp's pixel, as far as only this warp knows it.
struct WarpQueue {
  int head = 0;      // index of the first splat: a multiple of 32, as is kRing, so a group of 32 never wraps around
  int n_splats = 0;  // that are queued
};

/// What evaluating candidates has appended to this warp's queue.
struct Queued {
  static constexpr int kAllDone = -1;
  int n_splats;  // kAllDone if all four pixels are finished: nothing was appended, and no queue is read any more
  __device__ bool all_done() const { return n_splats < 0; }
};

/// `index` modulo kRing, for an index below 2 kRing.
__device__ __forceinline__ int wrapped(int index) {
  return index < kRing ? index : index - kRing;
}

/// Evaluate: each thread that has a candidate evaluates it at the four pixels and appends it to the queues of those it
/// contributes to. Two barriers inside: after the first, all warps have finished reading their queues; after the
/// second, the queues are filled.
__device__ __forceinline__ Queued queue_contributions(const Quad& quad, int candidate, bool has_candidate, bool is_done,
                                                      QueueEnds& ends, QuadMemory& shared) {
  const int lane = lane_id(), warp = static_cast<int>(threadIdx.x) / kWarpSize;
  std::int32_t position = 0;
  SplatMean mean{};
  SplatConic conic{};
  SplatColor color{};
  if (has_candidate) {
    position = shared.candidates[candidate];
    const std::int32_t id = __ldg(quad.ids + position);
    mean = load_mean(quad.splats, id);
    conic = load_conic(quad.splats, id);
    color = load_color(quad.splats, id);
  }
  const SplatShape<float> shape = make_splat_shape(mean, conic);
  float power[kPixels];
  unsigned contributing[kPixels];  // lanes whose splat contributes to each pixel
  std::uint32_t warp_counts = 0;   // how many, a byte per pixel
#pragma unroll
  for (int p = 0; p < kPixels; ++p) {
    const Footprint<float> footprint = evaluate_footprint(shape, quad.center_x + static_cast<float>(p % kQuadSide),
                                                          quad.center_y + static_cast<float>(p / kQuadSide));
    power[p] = footprint.power;
    contributing[p] = __ballot_sync(kFullWarp, footprint.contributes && has_candidate);
    warp_counts |= static_cast<std::uint32_t>(__popc(contributing[p])) << (8 * p);
  }
  if (lane == 0) shared.n_by_warp[warp] = warp_counts;
  // Counts are written, and all warps have finished reading their queues.
  if (__syncthreads_and(is_done)) return {Queued::kAllDone};
  // Counts of the warps ahead of this one, and of all; four bytes are added as one number.
  std::uint32_t ahead = 0, all = 0;
#pragma unroll
  for (int w = 0; w < kPixels; ++w) {
    const std::uint32_t counts = shared.n_by_warp[w];
    if (w < warp) ahead += counts;
    all += counts;
  }
#pragma unroll
  for (int p = 0; p < kPixels; ++p) {
    // List order is thread order: append behind the warps ahead and the lower lanes.
    if ((contributing[p] >> lane & 1) != 0) {
      const int n_before = byte_of(ahead, p) + __popc(contributing[p] & ((1u << lane) - 1));
      const int index = wrapped(ends.of_pixel[p] + n_before);
      shared.color_depth[p][index] = make_float4(color.v.x, color.v.y, color.v.z, mean.v.w);
      shared.power[p][index] = power[p];
      shared.position[p][index] = position;
    }
    ends.of_pixel[p] = wrapped(ends.of_pixel[p] + byte_of(all, p));
  }
  __syncthreads();  // the queues are filled
  return {byte_of(all, warp)};
}

/// Blend: the warp blends the first `count` <= 32 splats of its queue.
template <StoredParts kStored>
__device__ __forceinline__ void blend_queued(const QuadMemory& shared, const WarpQueue& queue, int count,
                                             GaussianWisePixel<kStored>& pixel) {
  const int warp = static_cast<int>(threadIdx.x) / kWarpSize, index = queue.head + lane_id();
  pixel.blend({lane_id() < count, shared.power[warp][index], shared.position[warp][index]},
              [&] { return shared.color_depth[warp][index]; });
}

/// One task: blends quad `task` with the whole block.
template <StoredParts kStored>
__device__ __forceinline__ void blend_quad(const BlendForwardCudaArgs& args, std::int32_t task, QuadMemory& shared) {
  const BlendForwardArgs& blend = args.blend;
  const int thread = static_cast<int>(threadIdx.x), warp = thread / kWarpSize;
  const std::int32_t tile = task / kTileQuads, quad_in_tile = task % kTileQuads;
  // The quad's upper left pixel within the tile, and the tile's within the image.
  const std::int32_t quad_x = quad_in_tile % kRowQuads * kQuadSide, quad_y = quad_in_tile / kRowQuads * kQuadSide;
  const std::int32_t tile_x = tile % blend.grid.columns * kCudaTileSide;
  const std::int32_t tile_y = tile / blend.grid.columns * kRowQuads * kQuadSide;
  if (tile_x + quad_x >= blend.grid.image_width || tile_y + quad_y >= blend.grid.image_height) return;
  const std::int32_t x = quad_x + warp % kQuadSide, y = quad_y + warp / kQuadSide;
  const TilePixel at{tile_x + x, tile_y + y, y * kCudaTileSide + x,
                     tile_x + x < blend.grid.image_width && tile_y + y < blend.grid.image_height};
  GaussianWisePixel<kStored> pixel(args, tile, at);
  const Quad quad{blend.splats, blend.bins.splat_ids + blend.bins.tile_offsets[tile],
                  static_cast<float>(tile_x + quad_x) + 0.5f, static_cast<float>(tile_y + quad_y) + 0.5f};

  const std::int32_t n_runs = (list_length(blend.bins, tile) + kWarpSize - 1) / kWarpSize;
  const std::uint32_t* const masks = args.quad_masks + args.buckets.offsets[tile] * kMasksPerBucket * kTileQuads +
                                     static_cast<std::int64_t>(quad_in_tile) * n_runs;
  QueueEnds ends;
  WarpQueue queue;
  int n_candidates = 0;
  bool is_done = !at.inside, all_done = false;
  // The mask with this thread's byte, loaded one scan ahead.
  const std::int32_t run = thread / kThreadsPerMask;
  std::uint32_t next_mask = run < n_runs ? __ldg(masks + run) : 0;
  for (std::int32_t start = 0; start < n_runs && !all_done; start += kScanned / kWarpSize) {
    // Scan the next 1024 entries.
    const unsigned marks = next_mask >> (thread % kThreadsPerMask * kScanBits) & 0xffu;
    const std::int32_t next_run = start + kScanned / kWarpSize + run;
    next_mask = next_run < n_runs ? __ldg(masks + next_run) : 0;
    n_candidates = add_candidates(shared, n_candidates, marks, start * kWarpSize + thread * kScanBits);
    __syncthreads();  // candidates are complete

    // Evaluate and blend full groups of 128 candidates. After the last scan, also the rest.
    const int wanted = start + kScanned / kWarpSize < n_runs ? kThreads : 1;
    int taken = 0;
    for (; n_candidates - taken >= wanted && !all_done; taken += kThreads) {
      const Queued added =
          queue_contributions(quad, taken + thread, taken + thread < n_candidates, is_done, ends, shared);
      all_done = added.all_done();
      for (queue.n_splats += added.n_splats; queue.n_splats >= kWarpSize && !is_done; queue.n_splats -= kWarpSize) {
        blend_queued(shared, queue, kWarpSize, pixel);
        queue.head = wrapped(queue.head + kWarpSize);
        is_done = pixel.is_finished();
      }
    }
    // Move the remaining candidates to the front. Unless all_done, fewer than kThreads are left, so source and
    // destination do not overlap. All reads of what is overwritten happened before the last barrier.
    const int n_left = n_candidates > taken ? n_candidates - taken : 0;
    if (taken > 0 && thread < n_left) shared.candidates[thread] = shared.candidates[taken + thread];
    n_candidates = n_left;
  }
  // Blend what is still queued. No barrier from here on.
  if (!at.inside) return;
  if (queue.n_splats > 0 && !is_done) blend_queued(shared, queue, queue.n_splats, pixel);
  pixel.store();
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

template <StoredParts kStored>
void launch(const BlendForwardCudaArgs& args, const LaunchContext& context) {
  const std::int64_t n_tasks = std::int64_t{kTileQuads} * args.blend.grid.n_tiles();
  B3DGS_CHECK(n_tasks < std::int64_t{1} << 30, "image too large for the combined kernel: ", n_tasks,
              " tasks, expected below 2^30");
  if (args.buckets.n > 0) {
    const auto blocks = static_cast<unsigned>((args.buckets.n * kMasksPerBucket + kMarkWarps - 1) / kMarkWarps);
    mark_quads_kernel<<<blocks, kMarkWarps * kWarpSize, 0, context.stream>>>(args);
    B3DGS_CUDA_CHECK_LAUNCH();
  }
  reset_tasks(args.next_task, context);
  const auto kernel = forward_combined_kernel<kStored>;
  kernel<<<resident_blocks(kernel, kThreads, context), kThreads, 0, context.stream>>>(
      args, static_cast<std::int32_t>(n_tasks));
  B3DGS_CUDA_CHECK_LAUNCH();
}

}  // namespace

void launch_forward_combined(const BlendForwardCudaArgs& args, const LaunchContext& context) {
  with_stored_parts(args.parts, [&](auto stored) { launch<stored.value>(args, context); });
}

}  // namespace b3dgs::cuda
