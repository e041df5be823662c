// Binning: (tile, splat) pairs sorted by tile and, within a tile, by depth. Splats are sorted by depth first; the pairs
// are then written in that order and sorted stably by tile, with short keys.
//
//   1. list_seen: stream compaction of the Gaussians that the view sees, in their order (CUB).
//   2. Radix sort of the seen Gaussians by depth (CUB). Its index in this order is a splat's id.
//   3. Exclusive scan of the tile counts in the order of ids: the first slot of each splat (CUB).
//   4. emit_pairs_kernel: a thread per id copies its splat and writes its pairs, tile and id, to its slots. The
//      whole warp writes the pairs of a splat with many tiles.
//   5. Radix sort of the pairs by tile (CUB); stable, so lists stay in depth order.
//   6. find_tiles_kernel: a thread per pair finds where each tile's list begins.
//   7. number_buckets_kernel: a warp per tile numbers its buckets, for kernels that work on buckets.
// With `deterministic`, step 5 carries slots instead of ids, and gather_slots_kernel looks up the ids afterwards.
// The kernels here use no shared memory and no barriers.

#include <thrust/iterator/counting_iterator.h>
#include <thrust/iterator/transform_iterator.h>
#include <thrust/iterator/zip_iterator.h>
#include <thrust/tuple.h>

#include <cub/cub.cuh>

#include <cstdint>

#include "raster/cuda/passes.h"
#include "raster/cuda/warp.cuh"
#include "raster/math/tiling.h"

namespace b3dgs::cuda {
namespace {

constexpr int kThreads = 256;
// Depths are positive floats: the sign bit is not sorted.
constexpr int kDepthBits = 31;
// Splats with more tiles than this are written by the whole warp; otherwise the other lanes would wait for one.
constexpr int kTilesPerThread = 16;

constexpr unsigned blocks_for(std::int64_t n) {
  return static_cast<unsigned>((n + kThreads - 1) / kThreads);
}

/// Predicate on (index, depth bits).
struct IsSeen {
  __device__ bool operator()(const thrust::tuple<std::int32_t, std::uint32_t>& gaussian) const {
    return thrust::get<1>(gaussian) != 0;
  }
};

/// Number of tiles of each splat, input of the scan; 0 behind the last.
struct TilesOfSplat {
  const std::int32_t* n_tiles;
  const std::int32_t* seen_by_depth;
  std::int64_t n_splats;
  __device__ std::int64_t operator()(std::int64_t id) const { return id < n_splats ? n_tiles[seen_by_depth[id]] : 0; }
};

template <class TileKey>
struct EmitArgs {
  ProjectOutputs projected;
  const std::int32_t* seen_by_depth;  // [M]
  const std::int64_t* slot_offsets;   // [M + 1]
  std::int64_t n_splats;
  TileGrid grid;
  Culling culling;
  Splat* splats;                    // [M] out
  Vec2f* extents;                   // [M] out
  std::int32_t* splat_of_gaussian;  // [N] out
  TileKey* tiles;                   // [n_pairs] out
  std::int32_t* pair_splats;        // [n_pairs] out
  std::int32_t* slots;              // [n_pairs] out: 0, 1, 2, ...; null if slots are not kept
};

/// A splat whose pairs are written: the inputs of tile_rows(), and its slots.
struct Emitted {
  Splat splat{};
  Vec2f extent{};
  std::int32_t radius = 0, id = 0;
  std::int64_t first = 0;  // first slot
  std::int32_t pairs = 0;  // number of pairs, as counted by the projection
};

/// The splat of another lane, in all lanes.
__device__ __forceinline__ Emitted emitted_of_lane(const Emitted& lane_splat, int lane) {
  Emitted other;
  other.splat.mean_x = __shfl_sync(kFullWarp, lane_splat.splat.mean_x, lane);
  other.splat.mean_y = __shfl_sync(kFullWarp, lane_splat.splat.mean_y, lane);
  other.splat.log2_opacity = __shfl_sync(kFullWarp, lane_splat.splat.log2_opacity, lane);
  other.splat.conic_xx = __shfl_sync(kFullWarp, lane_splat.splat.conic_xx, lane);
  other.splat.conic_xy = __shfl_sync(kFullWarp, lane_splat.splat.conic_xy, lane);
  other.splat.conic_yy = __shfl_sync(kFullWarp, lane_splat.splat.conic_yy, lane);
  other.extent = {__shfl_sync(kFullWarp, lane_splat.extent.x, lane), __shfl_sync(kFullWarp, lane_splat.extent.y, lane)};
  other.radius = __shfl_sync(kFullWarp, lane_splat.radius, lane);
  other.id = __shfl_sync(kFullWarp, lane_splat.id, lane);
  other.first = __shfl_sync(kFullWarp, lane_splat.first, lane);
  other.pairs = __shfl_sync(kFullWarp, lane_splat.pairs, lane);
  return other;
}

template <class TileKey>
__device__ __forceinline__ void emit_pair(const EmitArgs<TileKey>& args, std::int32_t id, std::int32_t tile,
                                          std::int64_t slot) {
  args.tiles[slot] = static_cast<TileKey>(tile);
  args.pair_splats[slot] = id;
  if (args.slots != nullptr) args.slots[slot] = static_cast<std::int32_t>(slot);
}

/// Writes one row of tiles, from pair number `pair` of the splat on, but never beyond its slots. The projection counted
/// tiles with the same arithmetic and the same bits (tiling.h), so the numbers agree. If they did not, this splat would
/// lose pairs or get unused ones (emit_unused), and other splats would not be affected.
template <class TileKey>
__device__ __forceinline__ void emit_row(const EmitArgs<TileKey>& args, const Emitted& e, std::int32_t row,
                                         TileSpan span, std::int32_t pair) {
  for (std::int32_t column = span.begin; column < span.end && pair < e.pairs; ++column, ++pair) {
    emit_pair(args, e.id, row * args.grid.columns + column, e.first + pair);
  }
}

/// Assigns every `stride`th remaining slot of the splat, from `pair` on, to a tile behind the last one, where it is
/// ignored.
template <class TileKey>
__device__ __forceinline__ void emit_unused(const EmitArgs<TileKey>& args, const Emitted& e, std::int32_t pair,
                                            std::int32_t stride) {
  for (; pair < e.pairs; pair += stride) emit_pair(args, e.id, args.grid.n_tiles(), e.first + pair);
}

/// Writes a splat's pairs with all lanes of the warp: a lane per row of tiles; a prefix sum gives each row its slots.
template <class TileKey>
__device__ __forceinline__ void emit_by_warp(const EmitArgs<TileKey>& args, const Emitted& e) {
  const TileRows rows = tile_rows(args.grid, args.culling, e.splat, e.extent, e.radius);
  std::int32_t pair = 0;
  for (std::int32_t begin = rows.begin; begin < rows.end; begin += kWarpSize) {
    const std::int32_t row = begin + lane_id();
    const TileSpan span = row < rows.end ? rows.span(args.grid, row) : TileSpan{0, 0};
    const int length = span.begin < span.end ? span.end - span.begin : 0;
    const int up_to_own = warp_prefix_sum(length);
    emit_row(args, e, row, span, pair + up_to_own - length);
    pair += __shfl_sync(kFullWarp, up_to_own, kWarpSize - 1);
  }
  emit_unused(args, e, pair + lane_id(), kWarpSize);
}

/// Copies each splat to its index in depth order and writes its pairs to its slots. A warp takes four runs of ids that
/// are far apart: splats of similar depth often have similar sizes, and a warp with only large ones would finish last.
template <class TileKey>
__global__ void __launch_bounds__(kThreads) emit_pairs_kernel(const EmitArgs<TileKey> args) {
  constexpr int kRun = 8;  // ids per run: 32 bytes of indices, one memory sector
  const std::int64_t warps = (args.n_splats + kWarpSize - 1) / kWarpSize;
  const std::int64_t warp = (static_cast<std::int64_t>(blockIdx.x) * kThreads + threadIdx.x) / kWarpSize;
  const std::int64_t id = (lane_id() / kRun * warps + warp) * kRun + lane_id() % kRun;
  Emitted lane_splat;
  if (warp < warps && id < args.n_splats) {
    const std::int32_t gaussian = args.seen_by_depth[id];
    lane_splat = {args.projected.splats[gaussian], args.projected.extents[gaussian], args.projected.radii[gaussian],
                  static_cast<std::int32_t>(id), args.slot_offsets[id]};
    lane_splat.pairs = static_cast<std::int32_t>(args.slot_offsets[id + 1] - lane_splat.first);
    args.splats[id] = lane_splat.splat;
    args.extents[id] = lane_splat.extent;
    args.splat_of_gaussian[gaussian] = lane_splat.id;
  }
  if (lane_splat.pairs > 0 && lane_splat.pairs <= kTilesPerThread) {
    std::int32_t pair = 0;
    visit_tile_rows(args.grid, args.culling, lane_splat.splat, lane_splat.extent, lane_splat.radius,
                    [&](std::int32_t row, TileSpan span) {
                      emit_row(args, lane_splat, row, span, pair);
                      pair += span.end - span.begin;
                    });
    emit_unused(args, lane_splat, pair, 1);
  }
  for (unsigned large = __ballot_sync(kFullWarp, lane_splat.pairs > kTilesPerThread); large != 0; large &= large - 1) {
    emit_by_warp(args, emitted_of_lane(lane_splat, __ffs(large) - 1));
  }
}

/// From the sorted slots to the splat and the slot of each list entry.
__global__ void __launch_bounds__(kThreads)
    gather_slots_kernel(const std::int32_t* slots, const std::int32_t* pair_splats, std::int64_t n_pairs,
                        std::int32_t* splat_ids, std::int64_t* pair_slots) {
  const std::int64_t i = static_cast<std::int64_t>(blockIdx.x) * kThreads + threadIdx.x;
  if (i >= n_pairs) return;
  splat_ids[i] = pair_splats[slots[i]];
  pair_slots[i] = slots[i];
}

/// tile_offsets[t] becomes the first pair whose tile is at least t; unused pairs are in tile n_tiles. Also resets the
/// number of buckets.
template <class TileKey>
__global__ void __launch_bounds__(kThreads)
    find_tiles_kernel(const TileKey* tiles, std::int64_t n_pairs, std::int32_t n_tiles, std::int64_t* tile_offsets,
                      unsigned long long* n_buckets) {
  const std::int64_t i = static_cast<std::int64_t>(blockIdx.x) * kThreads + threadIdx.x;
  if (i == 0) *n_buckets = 0;
  if (i > n_pairs) return;
  const std::int32_t before = i > 0 ? static_cast<std::int32_t>(tiles[i - 1]) : -1;
  const std::int32_t here = i < n_pairs ? static_cast<std::int32_t>(tiles[i]) : n_tiles;
  for (std::int32_t tile = before + 1; tile <= here; ++tile) tile_offsets[tile] = i;
}

/// A warp per tile takes a contiguous range of bucket numbers from an atomic counter: needs no scan, and leaves no
/// gaps, which would be idle blocks in the backward pass.
__global__ void __launch_bounds__(kThreads)
    number_buckets_kernel(const std::int64_t* tile_offsets, std::int32_t n_tiles, std::int64_t* bucket_offsets,
                          std::int32_t* tile_of_bucket, unsigned long long* n_buckets) {
  const auto tile = static_cast<std::int32_t>((blockIdx.x * kThreads + threadIdx.x) / kWarpSize);
  if (tile >= n_tiles) return;
  const std::int64_t n = (tile_offsets[tile + 1] - tile_offsets[tile] + kBucketEntries - 1) / kBucketEntries;
  unsigned long long first = 0;
  if (lane_id() == 0) {
    first = atomicAdd(n_buckets, static_cast<unsigned long long>(n));
    bucket_offsets[tile] = static_cast<std::int64_t>(first);
  }
  first = __shfl_sync(kFullWarp, first, 0);
  for (std::int64_t k = lane_id(); k < n; k += kWarpSize) tile_of_bucket[static_cast<std::int64_t>(first) + k] = tile;
}

/// Runs a CUB algorithm: queries the size of its temporary memory, allocates it, runs.
template <class Call>
void run_cub(BinBuffers& buffers, const LaunchContext& context, Call&& call) {
  std::size_t bytes = 0;
  B3DGS_CUDA_CHECK(call(nullptr, bytes));
  void* const temporary = buffers.temporary.resize(static_cast<std::int64_t>(bytes), context);
  B3DGS_CUDA_CHECK(call(temporary, bytes));
}

template <class Value, class Function>
void exclusive_scan(Function function, std::int64_t n, Value* out, BinBuffers& buffers, const LaunchContext& context) {
  const auto input = thrust::make_transform_iterator(thrust::counting_iterator<std::int64_t>(0), function);
  run_cub(buffers, context, [&](void* temporary, std::size_t& bytes) {
    return cub::DeviceScan::ExclusiveSum(temporary, bytes, input, out, n, context.stream);
  });
}

int bits_for(std::int64_t n) {
  int bits = 1;
  while ((std::int64_t{1} << bits) < n) ++bits;
  return bits;
}

/// Writes the pairs, sorts them by tile and finds the lists. The arrays of pairs in `emit` are null and allocated here.
template <class TileKey>
void sort_pairs_by_tile(const BinCudaArgs& args, EmitArgs<TileKey> emit, BinBuffers& buffers, PassScratch& scratch,
                        std::int64_t* tile_offsets, const LaunchContext& context) {
  const std::int32_t n_tiles = args.grid.n_tiles();
  const std::int64_t n = args.n_pairs;
  std::int32_t* const splat_ids = buffers.splat_ids.resize(n, context);
  TileKey* sorted = nullptr;
  std::int32_t *values = nullptr, *sorted_values = nullptr;
  const auto sort = [&](void* temporary, std::size_t& bytes) {
    return cub::DeviceRadixSort::SortPairs(temporary, bytes, emit.tiles, sorted, values, sorted_values, n, 0,
                                           bits_for(n_tiles + 1), context.stream);
  };
  std::size_t sort_bytes = 0;
  B3DGS_CUDA_CHECK(sort(nullptr, sort_bytes));
  unsigned char* temporary = nullptr;
  scratch.allocate(context, [&](ScratchArrays& arrays) {
    emit.tiles = arrays.take<TileKey>(n);
    emit.pair_splats = arrays.take<std::int32_t>(n);
    emit.slots = args.keep_slots ? arrays.take<std::int32_t>(n) : nullptr;
    sorted = arrays.take<TileKey>(n);
    sorted_values = args.keep_slots ? arrays.take<std::int32_t>(n) : splat_ids;
    temporary = arrays.take<unsigned char>(static_cast<std::int64_t>(sort_bytes));
  });
  values = args.keep_slots ? emit.slots : emit.pair_splats;
  if (args.n_splats > 0) {
    emit_pairs_kernel<<<blocks_for(args.n_splats), kThreads, 0, context.stream>>>(emit);
    B3DGS_CUDA_CHECK_LAUNCH();
    B3DGS_CUDA_CHECK(sort(temporary, sort_bytes));
    if (args.keep_slots) {
      gather_slots_kernel<<<blocks_for(args.n_pairs), kThreads, 0, context.stream>>>(
          sorted_values, emit.pair_splats, args.n_pairs, splat_ids, buffers.pair_slots.resize(args.n_pairs, context));
      B3DGS_CUDA_CHECK_LAUNCH();
    }
  }
  find_tiles_kernel<<<blocks_for(args.n_pairs + 1), kThreads, 0, context.stream>>>(
      sorted, args.n_pairs, n_tiles, tile_offsets, buffers.n_buckets.resize(1, context));
  B3DGS_CUDA_CHECK_LAUNCH();
}

}  // namespace

void list_seen(const ProjectOutputs& projected, std::int64_t n_gaussians, BinBuffers& buffers,
               const LaunchContext& context) {
  std::int32_t* const seen = buffers.seen.resize(n_gaussians + 1, context);
  std::uint32_t* const depths = buffers.depths.resize(n_gaussians, context);
  if (n_gaussians == 0) return;
  const auto all =
      thrust::make_zip_iterator(thrust::make_tuple(thrust::counting_iterator<std::int32_t>(0), projected.depth_bits));
  const auto listed = thrust::make_zip_iterator(thrust::make_tuple(seen, depths));
  // In the order of the Gaussians, so that equal depths keep it and results are reproducible. ViewCounts also has the
  // number; CUB writes it a second time, behind the list.
  run_cub(buffers, context, [&](void* temporary, std::size_t& bytes) {
    return cub::DeviceSelect::If(temporary, bytes, all, listed, seen + n_gaussians, n_gaussians, IsSeen{},
                                 context.stream);
  });
}

BinnedView bin(const BinCudaArgs& args, BinBuffers& buffers, PassScratch& scratch, const LaunchContext& context) {
  const std::int64_t n = args.n_splats;
  const std::int32_t n_tiles = args.grid.n_tiles();

  std::int32_t* const seen_by_depth = buffers.seen_by_depth.resize(n, context);
  std::uint32_t* const depths_sorted = buffers.depths_sorted.resize(n, context);
  if (n > 0) {
    run_cub(buffers, context, [&](void* temporary, std::size_t& bytes) {
      return cub::DeviceRadixSort::SortPairs(temporary, bytes, buffers.depths.data(), depths_sorted,
                                             buffers.seen.data(), seen_by_depth, n, 0, kDepthBits, context.stream);
    });
  }
  std::int64_t* const slot_offsets = buffers.slot_offsets.resize(n + 1, context);
  exclusive_scan<std::int64_t>(TilesOfSplat{args.projected.n_tiles, seen_by_depth, n}, n + 1, slot_offsets, buffers,
                               context);

  Splat* const splats = buffers.splats.resize(n, context);
  Vec2f* const extents = buffers.extents.resize(n, context);
  std::int32_t* const splat_of_gaussian = buffers.splat_of_gaussian.resize(args.n_gaussians, context);
  std::int64_t* const tile_offsets = buffers.tile_offsets.resize(n_tiles + 1, context);
  const auto sort = [&](auto key) {
    const EmitArgs<decltype(key)> emit{args.projected,    seen_by_depth, slot_offsets, n,
                                       args.grid,         args.culling,  splats,       extents,
                                       splat_of_gaussian, nullptr,       nullptr,      nullptr};
    sort_pairs_by_tile(args, emit, buffers, scratch, tile_offsets, context);
  };
  if (n_tiles < 1 << 16) {  // the tile behind the last must fit, too
    sort(std::uint16_t{});
  } else {
    sort(std::uint32_t{});
  }

  const std::int64_t n_buckets_max = args.n_pairs / kBucketEntries + n_tiles;
  std::int32_t* const tile_of_bucket = buffers.tile_of_bucket.resize(n_buckets_max, context);
  std::int64_t* const bucket_offsets = buffers.bucket_offsets.resize(n_tiles, context);
  unsigned long long* const n_buckets = buffers.n_buckets.data();
  number_buckets_kernel<<<blocks_for(std::int64_t{n_tiles} * kWarpSize), kThreads, 0, context.stream>>>(
      tile_offsets, n_tiles, bucket_offsets, tile_of_bucket, n_buckets);
  B3DGS_CUDA_CHECK_LAUNCH();
  return {splats,
          extents,
          splat_of_gaussian,
          {tile_offsets, buffers.splat_ids.data(), args.keep_slots ? buffers.pair_slots.data() : nullptr, slot_offsets,
           args.n_pairs},
          {bucket_offsets, tile_of_bucket, n_buckets, n_buckets_max}};
}

}  // namespace b3dgs::cuda
