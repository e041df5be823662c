// Sorts the lists in shared memory.
//
//   sort_lists   a block per run of 4352 entries of a long list, then a warp per short list
//   merge_runs   only if a list is longer than a run: merges sorted runs pairwise, a block per 4352 entries of output,
//                until one is left
//
//   list   | 5 1 4 2 3 | 9 8 0 6 |   -->   | 1 2 3 4 5 | 0 6 8 9 |   -->   | 0 1 2 3 4 5 6 8 9 |
//
// Keys are unique, so the result does not depend on the order in which they were written. The last pass of a list
// writes ids instead of keys. Barriers: those of CUB's merge sorts, and four in merge_runs.

#include <cub/block/block_merge_sort.cuh>
#include <cub/warp/warp_merge_sort.cuh>

#include <utility>

#include "raster/cuda/launch.cuh"
#include "raster/cuda/passes.h"
#include "raster/cuda/warp.cuh"

namespace b3dgs::cuda {
namespace {

constexpr int kThreads = 256, kWarps = kThreads / kWarpSize;
// Entries per thread. An odd number, so that threads that read their entries from shared memory use different banks.
constexpr int kItems = 17;
static_assert(kRunEntries == kThreads * kItems && kShortListEntries <= kWarpSize * kItems);

__device__ __forceinline__ std::int32_t id_of(EntryKey key, const ListArgs& args) {
  return min(static_cast<std::int32_t>(key & 0xffffffffu), static_cast<std::int32_t>(args.n_rows) - 1);
}

/// Returns the first number in [low, high) that does not meet `condition`, or `high`. No later number may meet it
/// either. All lanes of a warp must call it. They test 32 numbers at once, because a test waits for global memory.
template <class Condition>
__device__ __forceinline__ std::int32_t search_by_warp(std::int32_t low, std::int32_t high, Condition&& condition) {
  while (low < high) {
    const std::int32_t step = (high - low + kWarpSize - 1) / kWarpSize, probe = low + lane_id() * step;
    const int n_met = __popc(__ballot_sync(kFullWarp, probe < high && condition(probe)));
    high = min(high, low + n_met * step);
    low = n_met > 0 ? low + (n_met - 1) * step + 1 : high;
  }
  return low;
}

/// The run of a block. Block b takes the first run of the b-th longest list, and blocks from `n_lists` on take the
/// other runs. All lanes of a warp must construct it together.
struct Run {
  std::int32_t tile, index, length;  // index of the run in the list; length of the list
  std::int64_t list;                 // first entry of the list
  __device__ Run(const ListArgs& args, std::int32_t block, std::int32_t n_lists) {
    if (block < n_lists) {
      tile = args.tiles_by_length[block];
      index = 0;
    } else {
      // Finds the last tile that has at most `number` such runs before it.
      const std::int32_t number = block - n_lists;
      tile =
          search_by_warp(0, args.grid.n_tiles(), [&](std::int32_t at) { return args.first_more_runs[at] <= number; }) -
          1;
      index = 1 + number - args.first_more_runs[tile];
    }
    list = args.tile_offsets[tile];
    length = static_cast<std::int32_t>(args.tile_offsets[tile + 1] - list);
  }
  __device__ std::int32_t begin() const { return index * kRunEntries; }
  __device__ std::int32_t count() const { return min(length - begin(), kRunEntries); }
};

struct IsLess {
  __device__ bool operator()(EntryKey a, EntryKey b) const { return a < b; }
};

// Threads that sort a run together.
template <int kPerThread>
struct BlockSort : cub::BlockMergeSort<EntryKey, kThreads, kPerThread> {
  using cub::BlockMergeSort<EntryKey, kThreads, kPerThread>::BlockMergeSort;
  static constexpr std::int32_t kSorters = kThreads;
};
template <int kPerThread>
struct WarpSort : cub::WarpMergeSort<EntryKey, kPerThread, kWarpSize> {
  using cub::WarpMergeSort<EntryKey, kPerThread, kWarpSize>::WarpMergeSort;
  static constexpr std::int32_t kSorters = kWarpSize;
};

/// Shared memory of a sort, for any of these numbers of entries per thread.
template <template <int> class Sort>
union SortMemory {
  typename Sort<3>::TempStorage three;
  typename Sort<5>::TempStorage five;
  typename Sort<9>::TempStorage nine;
  typename Sort<kItems>::TempStorage all;
};

/// Sorts a run of at most kPerThread entries per sorting thread.
template <class Sort, int kPerThread>
__device__ __forceinline__ void sort_entries(const ListArgs& args, const Run& run, std::int32_t thread,
                                             typename Sort::TempStorage& memory) {
  const std::int64_t first = run.list + run.begin();
  const std::int32_t count = run.count();
  EntryKey keys[kPerThread];
#pragma unroll
  for (int k = 0; k < kPerThread; ++k) {
    const std::int32_t at = k * Sort::kSorters + thread;
    keys[k] = at < count ? args.keys[first + at] : ~EntryKey{0};
  }
  Sort(memory).Sort(keys, IsLess{});
#pragma unroll
  for (int k = 0; k < kPerThread; ++k) {
    const std::int32_t at = thread * kPerThread + k;
    if (at >= count) break;
    if (run.length > kRunEntries) {
      args.keys[first + at] = keys[k];
    } else {
      args.splat_ids[first + at] = id_of(keys[k], args);
    }
  }
}

template <template <int> class Sort>
__device__ __forceinline__ void sort_run(const ListArgs& args, const Run& run, std::int32_t thread,
                                         SortMemory<Sort>& memory) {
  constexpr std::int32_t kSorters = Sort<1>::kSorters;
  if (run.index == 0) {
    const std::int64_t bucket = args.bucket_offsets[run.tile];
    for (std::int32_t k = thread; k < n_buckets_of(run.length); k += kSorters) {
      args.tile_of_bucket[bucket + k] = run.tile;
    }
  }
  const std::int32_t count = run.count();
  if (count <= 3 * kSorters) {
    sort_entries<Sort<3>, 3>(args, run, thread, memory.three);
  } else if (count <= 5 * kSorters) {
    sort_entries<Sort<5>, 5>(args, run, thread, memory.five);
  } else if (count <= 9 * kSorters) {
    sort_entries<Sort<9>, 9>(args, run, thread, memory.nine);
  } else {
    sort_entries<Sort<kItems>, kItems>(args, run, thread, memory.all);
  }
}

__global__ void __launch_bounds__(kThreads) sort_lists_kernel(const ListArgs args) {
  __shared__ union {
    SortMemory<BlockSort> block;
    SortMemory<WarpSort> warps[kWarps];
  } memory;
  const auto block = static_cast<std::int32_t>(blockIdx.x), thread = static_cast<std::int32_t>(threadIdx.x);
  const auto n_long = static_cast<std::int32_t>(args.counts.n_long_lists);
  const std::int32_t n_runs = n_long + static_cast<std::int32_t>(args.counts.n_more_runs);
  if (block < n_runs) {
    sort_run<BlockSort>(args, Run(args, block, n_long), thread, memory.block);
    return;
  }
  const std::int32_t list = n_long + (block - n_runs) * kWarps + thread / kWarpSize;
  if (list >= args.grid.n_tiles()) return;
  const Run run(args, list, args.grid.n_tiles());
  if (run.length > 0) sort_run<WarpSort>(args, run, lane_id(), memory.warps[thread / kWarpSize]);
}

/// Returns how many of the first `count` entries of two merged sorted sequences come from `a`.
__device__ __forceinline__ std::int32_t split_merged(const EntryKey* a, std::int32_t n_a, const EntryKey* b,
                                                     std::int32_t n_b, std::int32_t count) {
  std::int32_t low = max(0, count - n_b), high = min(count, n_a);
  while (low < high) {
    const std::int32_t middle = (low + high) / 2;
    if (a[middle] < b[count - 1 - middle]) {
      low = middle + 1;
    } else {
      high = middle;
    }
  }
  return low;
}

/// Merges sorted sequences of `width` entries of each list pairwise, from args.keys to args.merged. If this completes a
/// list, it writes to args.splat_ids instead.
__global__ void __launch_bounds__(kThreads) merge_runs_kernel(const ListArgs args, std::int64_t width) {
  __shared__ EntryKey keys[kRunEntries];
  __shared__ std::int32_t splits[2];
  const Run run(args, static_cast<std::int32_t>(blockIdx.x), static_cast<std::int32_t>(args.counts.n_long_lists));
  if (run.length <= width) return;  // already sorted
  const auto thread = static_cast<std::int32_t>(threadIdx.x);
  const std::int32_t begin = run.begin(), count = run.count();
  const auto pair = static_cast<std::int32_t>(begin / (2 * width) * (2 * width)), first = begin - pair;
  auto n_a = static_cast<std::int32_t>(min(width, std::int64_t{run.length - pair}));
  auto n_b = static_cast<std::int32_t>(min(width, std::int64_t{run.length - pair - n_a}));
  const EntryKey *a = args.keys + run.list + pair, *b = a + n_a;
  if (const std::int32_t warp = thread / kWarpSize; warp < 2) {
    const std::int32_t wanted = first + warp * count;
    // The same search as split_merged().
    const std::int32_t split = search_by_warp(max(0, wanted - n_b), min(wanted, n_a),
                                              [&](std::int32_t k) { return a[k] < b[wanted - 1 - k]; });
    if (lane_id() == 0) splits[warp] = split;
  }
  __syncthreads();  // the inputs of this block are known
  a += splits[0];
  b += first - splits[0];
  n_a = splits[1] - splits[0];
  n_b = count - n_a;
  for (std::int32_t k = thread; k < count; k += kThreads) keys[k] = k < n_a ? a[k] : b[k - n_a];
  __syncthreads();          // all keys are in shared memory
  EntryKey merged[kItems];  // to shared memory first, so that neighbouring threads write neighbouring entries
  const std::int32_t own = min(thread * kItems, count);
  std::int32_t from_a = split_merged(keys, n_a, keys + n_a, n_b, own), from_b = n_a + own - from_a;
#pragma unroll
  for (int k = 0; k < kItems; ++k) {
    const bool has_a = from_a < n_a, has_b = from_b < count;
    if (!has_a && !has_b) break;
    const bool is_a = !has_b || (has_a && keys[from_a] < keys[from_b]);
    merged[k] = keys[is_a ? from_a++ : from_b++];
  }
  __syncthreads();  // all threads have read the keys
#pragma unroll
  for (int k = 0; k < kItems; ++k) {
    if (own + k < count) keys[own + k] = merged[k];
  }
  __syncthreads();  // the keys are merged
  for (std::int32_t k = thread; k < count; k += kThreads) {
    const std::int64_t to = run.list + begin + k;
    if (run.length <= 2 * width) {
      args.splat_ids[to] = id_of(keys[k], args);
    } else {
      args.merged[to] = keys[k];
    }
  }
}

}  // namespace

void sort_lists(const ListArgs& args, const LaunchContext& context) {
  const std::int64_t n_long = args.counts.n_long_lists, n_runs = n_long + args.counts.n_more_runs;
  const std::int64_t n_short_blocks = n_blocks(args.grid.n_tiles() - n_long, kWarps);
  launch_blocks(sort_lists_kernel, n_runs + n_short_blocks, kThreads, context, args);
  ListArgs pass = args;
  for (std::int64_t width = kRunEntries; width < args.counts.longest_list; width *= 2) {
    launch_blocks(merge_runs_kernel, n_runs, kThreads, context, pass, width);
    std::swap(pass.keys, pass.merged);
  }
}

}  // namespace b3dgs::cuda
