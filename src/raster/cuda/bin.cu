// Binning: makes a list for each tile of the splats that touch it, nearest first. The id of a splat is its row in
// ProjectOutputs.
//
//   projection        adds each span of tiles that a splat touches in a row to a difference array (tile_spans.cuh)
//   1. count_lists   one block: a prefix sum of this array gives the length of each list. Further prefix sums give
//                     the start of each list and the numbers of its buckets. Tiles are ordered by length
//   2. emit_entries   a thread per row of tiles that a splat of its block touches: writes a 64-bit key of depth and
//                     id to the next free entry of each tile's list, in any order. If a list is long, each block
//                     reserves all of its entries in a list at once
//   3. sort_lists     sorts each list (sort_lists.cu)
//
// With `with_slots`, find_slots_kernel then computes the slot of each entry: the first slot of its splat (a scan over
// Gaussians) plus the number of the splat's tiles before this one.

#include <thrust/iterator/counting_iterator.h>
#include <thrust/iterator/transform_iterator.h>

#include <cub/cub.cuh>

#include "raster/cuda/launch.cuh"
#include "raster/cuda/passes.h"
#include "raster/cuda/tile_spans.cuh"
#include "raster/cuda/warp.cuh"
#include "raster/math/tiling.h"

namespace b3dgs::cuda {
namespace {

constexpr int kThreads = 256;
constexpr int kNumberThreads = 512;

// ---- 1. count_lists

/// Returns the number of runs of a list after the first.
__device__ __forceinline__ std::int32_t n_more_runs(std::int32_t length) {
  return length > 0 ? (length - 1) / kRunEntries : 0;
}

/// Classes of list lengths, a quarter of an octave each. Longer lists are in the same or a lower class.
constexpr int kLengthClasses = 128;
__device__ __forceinline__ int length_class(std::int32_t length) {
  if (length < 4) return kLengthClasses - 1 - length;
  const int octave = 31 - __clz(length);
  return kLengthClasses - 1 - (4 * octave + (length >> (octave - 2) & 3) - 4);
}

/// Computes atomicAdd(counters + k, 1) with one atomic for all lanes that have the same k.
__device__ __forceinline__ std::int32_t take_place(std::int32_t* counters, int k) {
  const unsigned active = __activemask(), same = __match_any_sync(active, k);
  const int leader = __ffs(same) - 1;
  std::int32_t first = 0;
  if (lane_id() == leader) first = atomicAdd(counters + k, __popc(same));
  return __shfl_sync(active, first, leader) + __popc(same & ((1u << lane_id()) - 1));
}

/// Runs in one block, with four tiles per thread at a time.
__global__ void __launch_bounds__(kNumberThreads)
    number_lists_kernel(const ListArgs args, ViewCounts* const host_counts) {
  constexpr int kItems = 4;
  using ScanCounts = cub::BlockScan<std::int32_t, kNumberThreads>;
  using ScanPlaces = cub::BlockScan<std::uint64_t, kNumberThreads>;  // pairs in the upper half, buckets in the lower
  __shared__ union {
    typename ScanCounts::TempStorage counts;
    typename ScanPlaces::TempStorage places;
  } memory;
  __shared__ std::int32_t next_of_class[kLengthClasses];  // first a count of tiles, then the index of the next tile
  __shared__ std::int32_t longest, n_long_lists;
  __shared__ unsigned long long n_pairs;
  const auto thread = static_cast<std::int32_t>(threadIdx.x);
  const std::int32_t n_tiles = args.grid.n_tiles();
  if (thread < kLengthClasses) next_of_class[thread] = 0;
  if (thread == 0) longest = n_long_lists = 0, n_pairs = 0;
  __syncthreads();

  std::int32_t own_longest = 0, own_long = 0;
  unsigned long long own_pairs = 0;
  // Totals of all tiles before this round. length_before is the length of the last list.
  std::int32_t length_before = 0, more_runs_before = 0;
  std::uint64_t places_before = 0;
  for (std::int32_t start = 0; start < n_tiles; start += kNumberThreads * kItems) {
    const std::int32_t first = start + thread * kItems;
    std::int32_t lengths[kItems], growth = 0;
#pragma unroll
    for (int k = 0; k < kItems; ++k) {
      lengths[k] = first + k < n_tiles ? args.projected.list_growth[kCounterStride * (first + k)] : 0;
    }
    ScanCounts(memory.counts).InclusiveSum(lengths, lengths, growth);
    __syncthreads();  // the memory is free again
    std::uint64_t places[kItems], all_places = 0;
#pragma unroll
    for (int k = 0; k < kItems; ++k) {
      lengths[k] = first + k < n_tiles ? lengths[k] + length_before : 0;
      places[k] = std::uint64_t{static_cast<std::uint32_t>(lengths[k])} << 32 | n_buckets_of(lengths[k]);
      own_pairs += static_cast<unsigned long long>(lengths[k]);
      own_longest = max(own_longest, lengths[k]);
      own_long += lengths[k] >= kShortListEntries;
    }
    ScanPlaces(memory.places).ExclusiveSum(places, places, all_places);
    std::int32_t more_runs[kItems], all_more_runs = 0;
#pragma unroll
    for (int k = 0; k < kItems; ++k) more_runs[k] = n_more_runs(lengths[k]);
    if (__syncthreads_or(own_longest > kRunEntries)) {  // also: the memory is free again
      ScanCounts(memory.counts).ExclusiveSum(more_runs, more_runs, all_more_runs);
    }
#pragma unroll
    for (int k = 0; k < kItems; ++k) {
      if (first + k >= n_tiles) break;
      const std::uint64_t place = places_before + places[k];
      args.tile_offsets[first + k] = static_cast<std::int64_t>(place >> 32);
      args.next_entries[kCounterStride * (first + k)] = static_cast<std::int32_t>(place >> 32);
      args.bucket_offsets[first + k] = static_cast<std::int64_t>(place & 0xffffffffu);
      args.first_more_runs[first + k] = more_runs_before + more_runs[k];
      take_place(next_of_class, length_class(lengths[k]));
    }
    length_before += growth;
    places_before += all_places;
    more_runs_before += all_more_runs;
    __syncthreads();  // the memory is free again, and the last tile's class is counted
  }

  own_longest = warp_max(own_longest);
  own_long = static_cast<std::int32_t>(warp_sum(static_cast<unsigned>(own_long)));
  for (int distance = kWarpSize / 2; distance > 0; distance /= 2) {
    own_pairs += __shfl_xor_sync(kFullWarp, own_pairs, distance);
  }
  if (lane_id() == 0) {
    atomicAdd(&n_pairs, own_pairs);
    atomicMax(&longest, own_longest);
    if (own_long > 0) atomicAdd(&n_long_lists, own_long);
  }
  std::int32_t place = 0;
  ScanCounts(memory.counts).ExclusiveSum(thread < kLengthClasses ? next_of_class[thread] : 0, place);
  if (thread < kLengthClasses) next_of_class[thread] = place;
  if (thread == 0) args.tile_offsets[n_tiles] = static_cast<std::int64_t>(places_before >> 32);
  __syncthreads();  // class starts, offsets and the sums of all threads are ready
  if (thread == 0) {
    ViewCounts& out = *host_counts;
    const ViewCounts& projected = *args.projected.counts;
    out.n_splats = projected.n_splats;
    out.n_second = projected.n_second;
    out.first_invalid = projected.first_invalid;
    out.n_buckets = static_cast<std::int64_t>(places_before & 0xffffffffu);
    out.longest_list = longest;
    out.n_long_lists = n_long_lists;
    out.n_more_runs = more_runs_before;
    __threadfence_system();
    *static_cast<volatile std::int64_t*>(&out.n_pairs) = static_cast<std::int64_t>(n_pairs);  // the host polls it
  }
  for (std::int32_t tile = thread; tile < n_tiles; tile += kNumberThreads) {
    const auto length = static_cast<std::int32_t>(args.tile_offsets[tile + 1] - args.tile_offsets[tile]);
    args.tiles_by_length[take_place(next_of_class, length_class(length))] = tile;
  }
}

// ---- 2. emit_entries

/// If a list has more entries, each block reserves its own entries in a list at once. Tiles without an entry in
/// BlockCounters are an exception.
constexpr std::int64_t kManyInOneList = 8192;

/// Reserves the entries that the block has counted. Each count becomes the index of the first entry.
__device__ __forceinline__ void reserve_entries(BlockCounters& counters, std::int32_t* next_entries) {
  constexpr int kOfThread = BlockCounters::kSlots / kThreads;  // atomics in flight
  static_assert(BlockCounters::kSlots % kThreads == 0);
  std::int32_t entry[kOfThread];
#pragma unroll
  for (int k = 0; k < kOfThread; ++k) entry[k] = counters.count[threadIdx.x + k * kThreads];
#pragma unroll
  for (int k = 0; k < kOfThread; ++k) {
    if (entry[k] == 0) continue;
    entry[k] = atomicAdd(next_entries + kCounterStride * counters.tile[threadIdx.x + k * kThreads], entry[k]);
  }
#pragma unroll
  for (int k = 0; k < kOfThread; ++k) counters.count[threadIdx.x + k * kThreads] = entry[k];
}

/// kReservesAtOnce: see kManyInOneList.
template <bool kReservesAtOnce>
__global__ void __launch_bounds__(kThreads) emit_entries_kernel(const ListArgs args) {
  constexpr int kAtOnce = 4;  // atomics in flight
  __shared__ SpanTasks<kThreads> tasks;
  __shared__ BlockCounters counters;
  __shared__ EntryKey keys[kThreads];
  const auto n_pairs = static_cast<std::int32_t>(args.counts.n_pairs);
  const std::int64_t i = spread_row<kThreads>();
  TileRows rows = no_tile_rows(args.culling);
  const std::int32_t radius = i < args.n_rows ? args.projected.radii[i] : 0;
  if (radius > 0) {
    const Splat& splat = args.projected.splats[i];
    rows = tile_rows(with_known_tiles(args.grid), args.culling, splat, args.projected.extents[i], radius);
    keys[threadIdx.x] = EntryKey{__float_as_uint(splat.depth)} << 32 | static_cast<std::uint32_t>(i);
  }
  if (kReservesAtOnce) counters.reset(kThreads);
  const int n_tasks = share_spans(tasks, rows);  // its barriers also cover the keys and the counters
  // The projection counted the tiles with the same arithmetic and the same bits (tiling.h), so exactly the entries of
  // each list are written.
  if constexpr (kReservesAtOnce) {
    visit_spans(tasks, args.grid, n_tasks, [&](int, std::int32_t row, Span span) {
      for (std::int32_t column = span.begin; column < span.end; ++column) {
        if (std::int32_t* const count = counters.take(row * args.grid.columns + column)) atomicAdd(count, 1);
      }
    });
    __syncthreads();  // all entries are counted
    reserve_entries(counters, args.next_entries);
    __syncthreads();  // the positions of the block's entries are known
  }
  visit_spans(tasks, args.grid, n_tasks, [&](int thread, std::int32_t row, Span span) {
    const EntryKey key = keys[thread];
    const std::int32_t first = row * args.grid.columns;
    for (std::int32_t column = span.begin; column < span.end; column += kAtOnce) {
      std::int32_t entry[kAtOnce];
#pragma unroll
      for (int k = 0; k < kAtOnce; ++k) {
        const std::int32_t tile = first + column + k;
        std::int32_t* next = args.next_entries + kCounterStride * tile;
        if (kReservesAtOnce && column + k < span.end) {
          if (std::int32_t* const of_block = counters.find(tile)) next = of_block;
        }
        entry[k] = column + k < span.end ? atomicAdd(next, 1) : n_pairs;
      }
#pragma unroll
      for (int k = 0; k < kAtOnce; ++k) {
        if (entry[k] < n_pairs) args.keys[entry[k]] = key;
      }
    }
  });
}

// ---- slots

/// Runs a block per tile.
__global__ void __launch_bounds__(kThreads) find_slots_kernel(const ListArgs args) {
  const auto tile = static_cast<std::int32_t>(blockIdx.x);
  const std::int32_t tile_row = tile / args.grid.columns, column = tile % args.grid.columns;
  for (std::int64_t k = args.tile_offsets[tile] + threadIdx.x; k < args.tile_offsets[tile + 1]; k += kThreads) {
    const std::int32_t id = args.splat_ids[k];
    const TileRows rows = tile_rows(args.grid, args.culling, args.projected.splats[id], args.projected.extents[id],
                                    args.projected.radii[id]);
    std::int64_t slot = args.slot_offsets[id] + column - rows.span(args.grid, tile_row).begin;
    for (std::int32_t row = rows.begin; row < tile_row; ++row) {
      const Span span = rows.span(args.grid, row);
      slot += max(span.end - span.begin, 0);
    }
    args.pair_slots[k] = slot;
  }
}

/// Returns the number of tiles of each row as the input of a scan, and 0 after the last row.
struct TilesOfRow {
  ListArgs lists;
  __device__ std::int64_t operator()(std::int64_t i) const {
    const ProjectOutputs& rows = lists.projected;
    if (i >= lists.n_rows || rows.radii[i] == 0) return 0;
    return tiles_touched(lists.grid, lists.culling, rows.splats[i], rows.extents[i], rows.radii[i]);
  }
};

struct IsSeen {
  const std::int32_t* radii;
  __device__ bool operator()(std::int32_t i) const { return radii[i] > 0; }
};

/// Runs a CUB algorithm: queries the size of its temporary memory, allocates it, and runs it.
template <class Call>
void run_cub(BinBuffers& buffers, const LaunchContext& context, Call&& call) {
  std::size_t bytes = 0;
  B3DGS_CUDA_CHECK(call(nullptr, bytes));
  void* const temporary = buffers.temporary.resize(static_cast<std::int64_t>(bytes), context);
  B3DGS_CUDA_CHECK(call(temporary, bytes));
}

}  // namespace

void list_seen(const ProjectOutputs& projected, std::int64_t n_rows, BinBuffers& buffers,
               const LaunchContext& context) {
  std::int32_t* const seen = buffers.seen.resize(n_rows + 1, context);
  if (n_rows == 0) return;
  // CUB writes the number after the list. It is not used, because ViewCounts also has it.
  run_cub(buffers, context, [&](void* temporary, std::size_t& bytes) {
    return cub::DeviceSelect::If(temporary, bytes, thrust::counting_iterator<std::int32_t>(0), seen, seen + n_rows,
                                 n_rows, IsSeen{projected.radii}, context.stream);
  });
}

void count_lists(ListArgs& args, BinBuffers& buffers, ViewCounts* host_counts, const LaunchContext& context) {
  const std::int32_t n_tiles = args.grid.n_tiles();
  args.tile_offsets = buffers.tile_offsets.resize(n_tiles + 1, context);
  args.bucket_offsets = buffers.bucket_offsets.resize(n_tiles, context);
  args.next_entries = buffers.next_entries.resize(kCounterStride * n_tiles, context);
  args.first_more_runs = buffers.first_more_runs.resize(n_tiles, context);
  args.tiles_by_length = buffers.tiles_by_length.resize(n_tiles, context);
  launch_blocks(number_lists_kernel, 1, kNumberThreads, context, args, host_counts);
}

void bin(ListArgs& args, bool with_slots, BinBuffers& buffers, PassScratch& scratch, const LaunchContext& context) {
  const std::int64_t n_pairs = args.counts.n_pairs;
  args.splat_ids = buffers.splat_ids.resize(n_pairs, context);
  args.tile_of_bucket = buffers.tile_of_bucket.resize(args.counts.n_buckets, context);
  if (with_slots) {
    args.slot_offsets = buffers.slot_offsets.resize(args.n_rows + 1, context);
    args.pair_slots = buffers.pair_slots.resize(n_pairs, context);
  }
  assign_scratch(scratch, context, [&](ScratchArrays& arrays) {
    args.keys = arrays.take<EntryKey>(n_pairs);
    args.merged = arrays.take<EntryKey>(n_pairs);
  });
  if (n_pairs > 0) {
    const bool has_long_list = args.counts.longest_list > kManyInOneList;
    launch_blocks(has_long_list ? emit_entries_kernel<true> : emit_entries_kernel<false>,
                  n_blocks(args.n_rows, kThreads), kThreads, context, args);
    sort_lists(args, context);
    if (with_slots) {
      const auto n_tiles =
          thrust::make_transform_iterator(thrust::counting_iterator<std::int64_t>(0), TilesOfRow{args});
      run_cub(buffers, context, [&](void* temporary, std::size_t& bytes) {
        return cub::DeviceScan::ExclusiveSum(temporary, bytes, n_tiles, args.slot_offsets, args.n_rows + 1,
                                             context.stream);
      });
      launch_blocks(find_slots_kernel, args.grid.n_tiles(), kThreads, context, args);
    }
  }
}

}  // namespace b3dgs::cuda
