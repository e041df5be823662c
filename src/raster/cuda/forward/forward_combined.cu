// Forward blend, combined: blocks of four warps take tasks of 2 x 2 pixels (quads) from the pool, a warp for each
// pixel, a lane for each splat (the paper's fine-grained combined load balancing). A crowded tile becomes 32 or 64
// tasks for as many blocks, so the longest task is one pixel's list divided by 32.
//
// Beyond the paper, since a pixel sees little of a crowded list: a first kernel marks which quads each splat touches, a
// bit for each entry, and tasks fetch nothing else. What they fetch is evaluated by one thread at all four pixels and
// queued for those it contributes to. So a pixel's warp blends whole groups of 32 splats that all contribute.

#include "raster/cuda/forward/forward_table.h"
#include "raster/cuda/forward/gaussian_wise.cuh"
#include "raster/cuda/launch.cuh"

namespace b3dgs::cuda {
namespace {

constexpr int kPixels = 4;
constexpr int kThreads = kPixels * kWarpSize;
constexpr int kRing = kWarpSize + kThreads;  // of a pixel's queue: at most 31 left over and 128 new
static_assert(kRing % kWarpSize == 0, "groups of 32 do not go over the ring's end");
constexpr int kScanned = 8 * kThreads;  // list entries looked at in one go, 8 bits a thread
constexpr int kMarkWarps = 8;           // of a block of the marking kernel

/// Quads of a tile, which is 16 px wide.
template <int kTilePixels>
struct TileQuads {
  static constexpr int kColumns = 8, kCount = kTilePixels / kPixels, kRows = kCount / kColumns;
};

/// Quads of 4 rows of a tile that a splat touches, a bit each, row by row.
template <int kTilePixels>
__device__ __forceinline__ std::uint32_t touched_quads(const TileGrid& quads, const TileRows& rows, std::int32_t x,
                                                       std::int32_t y) {
  constexpr int kColumns = TileQuads<kTilePixels>::kColumns;
  std::uint32_t touched = 0;
#pragma unroll
  for (std::int32_t row = 0; row < kWarpSize / kColumns; ++row) {
    if (y + row < rows.begin || y + row >= rows.end) continue;
    const TileSpan span = rows.span(quads, y + row);
    const std::int32_t begin = max(span.begin - x, 0), end = min(span.end - x, kColumns);
    if (begin < end) touched |= ((1u << end) - (1u << begin)) << (row * kColumns);
  }
  return touched;
}

/// A warp takes a bucket and writes one word for each quad: which of the 32 splats touch it. A tile's words lie quad by
/// quad, so that a task reads its own side by side.
template <int kTilePixels>
__global__ void __launch_bounds__(kMarkWarps* kWarpSize) mark_quads_kernel(const BlendForwardCudaArgs args) {
  using Quads = TileQuads<kTilePixels>;
  const BlendForwardArgs& blend = args.blend;
  const std::int64_t bucket = static_cast<std::int64_t>(blockIdx.x) * kMarkWarps + threadIdx.x / kWarpSize;
  if (bucket >= static_cast<std::int64_t>(*args.buckets.n)) return;
  const std::int32_t tile = args.buckets.tile_of_bucket[bucket];
  const std::int64_t begin = blend.bins.tile_offsets[tile], end = blend.bins.tile_offsets[tile + 1];
  const std::int64_t first = args.buckets.offsets[tile], entry = begin + (bucket - first) * kWarpSize + lane_id();
  TileRows rows{};  // none
  if (entry < end) {
    const std::int32_t id = blend.bins.splat_ids[entry];
    const float4 place = load_place(blend.splats, id).v, conic = load_conic(blend.splats, id).v;
    const Splat splat{place.x, place.y, place.z, place.w, conic.x, conic.y, conic.z, 0, 0, 0, 0, 0};
    // One below the cutoff contributes nowhere, and has no ellipse.
    if (place.z >= kLog2AlphaMin) {
      rows = tile_rows(make_tile_grid(blend.grid.image_width, blend.grid.image_height, {2, 2}), Culling::kEllipse,
                       splat, blend.extents[id], 0);
    }
  }
  const TileGrid quads = make_tile_grid(blend.grid.image_width, blend.grid.image_height, {2, 2});
  const std::int32_t x = tile % blend.grid.columns * Quads::kColumns, y = tile / blend.grid.columns * Quads::kRows;
  std::uint32_t* const words = args.quad_words + first * Quads::kCount + (bucket - first);
  const std::int64_t n_buckets = (end - begin + kWarpSize - 1) / kWarpSize;
#pragma unroll
  for (int quad = 0; quad < Quads::kCount; quad += kWarpSize) {
    const std::uint32_t touched = touched_quads<kTilePixels>(quads, rows, x, y + quad / Quads::kColumns);
    words[(quad + lane_id()) * n_buckets] = warp_transpose(touched);
  }
}

/// What the warps of a block share while they work on a quad.
struct QuadMemory {
  std::int32_t candidates[kThreads + kScanned];  // positions in the tile's list that touch the quad
  // Contributions waiting for each pixel's warp.
  float4 shown[kPixels][kRing];  // red, green, blue, depth
  float power[kPixels][kRing];   // log2 of the uncapped alpha
  std::int32_t position[kPixels][kRing];
  std::uint32_t n_by_warp[kPixels];
};

/// Appends the positions of the next kScanned entries that touch the quad. `byte` has the thread's 8 of them, from
/// `position` on. Holds one barrier; the candidates are there behind the next one. Returns how many there are in all.
__device__ __forceinline__ int add_candidates(QuadMemory& memory, int n_candidates, unsigned byte,
                                              std::int32_t position) {
  const int warp = static_cast<int>(threadIdx.x) / kWarpSize;
  const int own = __popc(byte), up_to_own = warp_prefix_sum(own);
  if (lane_id() == kWarpSize - 1) memory.n_by_warp[warp] = static_cast<std::uint32_t>(up_to_own);
  __syncthreads();
  int place = n_candidates + up_to_own - own;
#pragma unroll
  for (int w = 0; w < kPixels; ++w) {
    const int found = static_cast<int>(memory.n_by_warp[w]);
    if (w < warp) place += found;
    n_candidates += found;
  }
  for (; byte != 0; byte &= byte - 1) memory.candidates[place++] = position + __ffs(byte) - 1;
  return n_candidates;
}

__device__ __forceinline__ int byte_of(std::uint32_t bytes, int index) {
  return static_cast<int>(bytes >> (8 * index) & 0xffu);
}

/// A quad on its tile's list.
struct Quad {
  const Splat* splats;
  const std::int32_t* ids;   // the tile's list
  float center_x, center_y;  // of the upper left pixel
};

/// Places of the queues' ends, below kRing; the same in all threads.
struct QueueEnds {
  int place[kPixels] = {0, 0, 0, 0};
};

__device__ __forceinline__ int wrapped(int place) {
  return place < kRing ? place : place - kRing;
}

/// Evaluates a candidate (or none, if negative) at the four pixels and queues it where it contributes. Returns how many
/// the own pixel got; -1 if all pixels are done, and nothing was queued. Holds two barriers: behind the first everyone
/// has emptied its queue, behind the second the queues are filled.
__device__ __forceinline__ int queue_contributions(const Quad& quad, int candidate, bool is_done, QueueEnds& ends,
                                                   QuadMemory& memory) {
  const int lane = lane_id(), warp = static_cast<int>(threadIdx.x) / kWarpSize;
  const bool is_one = candidate >= 0;
  std::int32_t position = 0;
  SplatPlace place{};
  SplatConic conic{};
  SplatColor color{};
  if (is_one) {
    position = memory.candidates[candidate];
    const std::int32_t id = __ldg(quad.ids + position);
    place = load_place(quad.splats, id);
    conic = load_conic(quad.splats, id);
    color = load_color(quad.splats, id);
  }
  const SplatShape<float> shape = make_splat_shape(place, conic);
  float power[kPixels];
  unsigned found[kPixels];
  std::uint32_t own_counts = 0;
#pragma unroll
  for (int p = 0; p < kPixels; ++p) {
    const Reach<float> reach =
        evaluate_reach(shape, quad.center_x + static_cast<float>(p % 2), quad.center_y + static_cast<float>(p / 2));
    power[p] = reach.power;
    found[p] = __ballot_sync(kFullWarp, reach.contributes && is_one);
    own_counts |= static_cast<std::uint32_t>(__popc(found[p])) << (8 * p);
  }
  if (lane == 0) memory.n_by_warp[warp] = own_counts;
  if (__syncthreads_and(is_done)) return -1;
  // A byte holds up to 128, so bytes are added as one number.
  std::uint32_t ahead = 0, all = 0;
#pragma unroll
  for (int w = 0; w < kPixels; ++w) {
    const std::uint32_t counts = memory.n_by_warp[w];
    if (w < warp) ahead += counts;
    all += counts;
  }
#pragma unroll
  for (int p = 0; p < kPixels; ++p) {
    if ((found[p] >> lane & 1) != 0) {
      const int rank = byte_of(ahead, p) + __popc(found[p] & ((1u << lane) - 1));
      const int slot = wrapped(ends.place[p] + rank);
      memory.shown[p][slot] = make_float4(color.v.x, color.v.y, color.v.z, place.v.w);
      memory.power[p][slot] = power[p];
      memory.position[p][slot] = position;
    }
    ends.place[p] = wrapped(ends.place[p] + byte_of(all, p));
  }
  __syncthreads();
  return byte_of(all, warp);
}

/// Blends the `count` splats of the warp's queue from `head` on. Heads move by 32 and the ring holds a multiple of
/// that, so no group goes over its end.
template <KeptParts kKept>
__device__ __forceinline__ void blend_queued(const QuadMemory& memory, int head, int count,
                                             GaussianWisePixel<kKept>& pixel) {
  const int warp = static_cast<int>(threadIdx.x) / kWarpSize, slot = head + lane_id();
  pixel.blend({lane_id() < count, memory.power[warp][slot], memory.position[warp][slot]},
              [&] { return memory.shown[warp][slot]; });
}

template <int kTilePixels, KeptParts kKept>
__device__ __forceinline__ void blend_quad(const BlendForwardCudaArgs& args, std::int32_t task, QuadMemory& memory) {
  using Quads = TileQuads<kTilePixels>;
  const BlendForwardArgs& blend = args.blend;
  const int thread = static_cast<int>(threadIdx.x), warp = thread / kWarpSize;
  const std::int32_t tile = task / Quads::kCount, own_quad = task % Quads::kCount;
  const std::int32_t quad_x = own_quad % Quads::kColumns * 2, quad_y = own_quad / Quads::kColumns * 2;
  const std::int32_t tile_x = tile % blend.grid.columns * 16, tile_y = tile / blend.grid.columns * Quads::kRows * 2;
  if (tile_x + quad_x >= blend.grid.image_width || tile_y + quad_y >= blend.grid.image_height) return;
  const std::int32_t x = quad_x + warp % 2, y = quad_y + warp / 2;
  const TilePixel at{tile_x + x, tile_y + y, y * 16 + x,
                     tile_x + x < blend.grid.image_width && tile_y + y < blend.grid.image_height};
  GaussianWisePixel<kKept> pixel(args, tile, at);
  const Quad quad{blend.splats, blend.bins.splat_ids + blend.bins.tile_offsets[tile],
                  static_cast<float>(tile_x + quad_x) + 0.5f, static_cast<float>(tile_y + quad_y) + 0.5f};

  const std::int32_t n_buckets = (list_length(blend.bins, tile) + kWarpSize - 1) / kWarpSize;
  const std::uint32_t* const words =
      args.quad_words + args.buckets.offsets[tile] * Quads::kCount + static_cast<std::int64_t>(own_quad) * n_buckets;
  QueueEnds ends;
  int head = 0, waiting = 0, n_candidates = 0;
  bool is_done = !at.inside, everyone_is_done = false;
  const std::int32_t own_bucket = thread / 4;
  std::uint32_t next_word = own_bucket < n_buckets ? __ldg(words + own_bucket) : 0;
  for (std::int32_t start = 0; start < n_buckets && !everyone_is_done; start += kScanned / kWarpSize) {
    const unsigned byte = next_word >> (thread % 4 * 8) & 0xffu;
    const std::int32_t next_bucket = start + kScanned / kWarpSize + own_bucket;
    next_word = next_bucket < n_buckets ? __ldg(words + next_bucket) : 0;
    n_candidates = add_candidates(memory, n_candidates, byte, start * kWarpSize + thread * 8);
    __syncthreads();  // the candidates are there

    const int wanted = start + kScanned / kWarpSize < n_buckets ? kThreads : 1;  // whole rounds, but for the last
    int taken = 0;
    for (; n_candidates - taken >= wanted && !everyone_is_done; taken += kThreads) {
      const int own_candidate = taken + thread < n_candidates ? taken + thread : -1;
      const int n_new = queue_contributions(quad, own_candidate, is_done, ends, memory);
      everyone_is_done = n_new < 0;
      for (waiting += n_new; waiting >= kWarpSize && !is_done; waiting -= kWarpSize) {
        blend_queued(memory, head, kWarpSize, pixel);
        head = wrapped(head + kWarpSize);
        is_done = pixel.is_finished();
      }
    }
    // What is left over moves to the front. It is less than one for each thread, and all reads of the places that are
    // overwritten lie before the last barrier.
    const int n_left = n_candidates > taken ? n_candidates - taken : 0;
    if (taken > 0 && thread < n_left) memory.candidates[thread] = memory.candidates[taken + thread];
    n_candidates = n_left;
  }
  if (!at.inside) return;
  if (waiting > 0 && !is_done) blend_queued(memory, head, waiting, pixel);
  pixel.store();
}

template <int kTilePixels, KeptParts kKept>
__global__ void __launch_bounds__(kThreads)
    forward_combined_kernel(const BlendForwardCudaArgs args, const std::int32_t n_tasks) {
  __shared__ QuadMemory memory;
  __shared__ std::int32_t tickets[2];
  // Tickets are drawn a task ahead, so that nobody waits for the counter; the first is the block's own number.
  auto task = static_cast<std::int32_t>(blockIdx.x);
  for (int turn = 0; task < n_tasks; turn ^= 1) {
    std::int32_t upcoming = 0;
    if (threadIdx.x == 0) upcoming = static_cast<std::int32_t>(gridDim.x) + atomicAdd(args.next_task, 1);
    blend_quad<kTilePixels, kKept>(args, task, memory);
    if (threadIdx.x == 0) tickets[turn] = upcoming;
    __syncthreads();  // the ticket is there, and the memory is free; the other ticket may still be read
    task = tickets[turn];
  }
}

template <int kTilePixels, KeptParts kKept>
void launch(const BlendForwardCudaArgs& args, const LaunchContext& context) {
  const std::int64_t n_tasks = std::int64_t{TileQuads<kTilePixels>::kCount} * args.blend.grid.n_tiles();
  B3DGS_CHECK(n_tasks < std::int64_t{1} << 30, "tasks are counted in 32 bits; the image has ", n_tasks);
  if (args.buckets.n_max > 0) {
    const auto blocks = static_cast<unsigned>((args.buckets.n_max + kMarkWarps - 1) / kMarkWarps);
    mark_quads_kernel<kTilePixels><<<blocks, kMarkWarps * kWarpSize, 0, context.stream>>>(args);
    B3DGS_CUDA_CHECK_LAUNCH();
  }
  const auto kernel = forward_combined_kernel<kTilePixels, kKept>;
  kernel<<<resident_blocks(kernel, kThreads, context), kThreads, 0, context.stream>>>(
      args, static_cast<std::int32_t>(n_tasks));
  B3DGS_CUDA_CHECK_LAUNCH();
}

}  // namespace

void launch_forward_combined(const BlendForwardCudaArgs& args, const LaunchContext& context) {
  with_tile_pixels(args.blend.grid.tile, [&](auto pixels) {
    with_kept_parts(args.parts, [&](auto kept) { launch<pixels.value, kept.value>(args, context); });
  });
}

KernelResources forward_combined_resources(const TileShape& tile) {
  KernelResources resources;
  with_tile_pixels(tile, [&](auto pixels) {
    resources = kernel_resources(forward_combined_kernel<pixels.value, KeptParts::kNone>, kThreads);
  });
  return resources;
}

}  // namespace b3dgs::cuda
