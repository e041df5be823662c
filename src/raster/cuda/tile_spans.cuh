// Splits the rows of tiles that a block's splats touch evenly among its threads, because one splat may touch one row
// and its neighbour a hundred.
//
//   thread        0     1     2     3
//   rows          3     0     1     2          of its splat
//   task        0 1 2        3    4 5          of threads 0, 1, 2, 3, 0, 1
#pragma once

#include <cub/block/block_scan.cuh>

#include "raster/cuda/passes.h"
#include "raster/math/tiling.h"

namespace b3dgs::cuda {

/// Returns the grid with known tile sizes, so that divisions become products. The tiles of both families are 16 px
/// wide, and 8 or 16 px high.
__device__ __forceinline__ TileGrid with_known_tiles(const TileGrid& grid) {
  static_assert(kPaperTile.width == kOwnTile.width);
  const std::int32_t height = grid.tile.height == kPaperTile.height ? kPaperTile.height : kOwnTile.height;
  return {grid.image_width, grid.image_height, {kOwnTile.width, height}, grid.columns, grid.rows};
}

/// Shared memory of share_spans() and visit_spans().
template <int kThreads>
struct SpanTasks {
  TileRows rows[kThreads];
  int up_to[kThreads];  // number of rows of all threads up to and including this one
  typename cub::BlockScan<int, kThreads>::TempStorage scan;
};

/// Returns the array row of a thread, which may be past the last. Blocks take runs of rows that are far apart, because
/// neighbours often have similar sizes and a block with only large splats would finish last.
template <int kThreads>
__device__ __forceinline__ std::int64_t spread_row() {
  constexpr int kRun = 8;  // as floats, a memory sector
  const auto thread = static_cast<std::int64_t>(threadIdx.x);
  return (thread / kRun * gridDim.x + blockIdx.x) * kRun + thread % kRun;
}

/// Distributes the rows of tiles that the block's splats touch, for visit_spans(), and returns their number. `rows` are
/// those of this thread's splat, none if rows.begin == rows.end. All threads of the block must call it. Barriers: one,
/// and those of the scan.
template <int kThreads>
__device__ __forceinline__ int share_spans(SpanTasks<kThreads>& tasks, const TileRows& rows) {
  int up_to = 0, n_tasks = 0;
  cub::BlockScan<int, kThreads>(tasks.scan).InclusiveSum(max(rows.end - rows.begin, 0), up_to, n_tasks);
  tasks.rows[threadIdx.x] = rows;
  tasks.up_to[threadIdx.x] = up_to;
  __syncthreads();  // the rows of all threads are known
  return n_tasks;
}

/// Calls visit(thread, row, span) for each row of tiles that the splat of a thread touches. `n_tasks` is the result of
/// share_spans(). All threads of the block must call it.
template <int kThreads, class Visit>
__device__ __forceinline__ void visit_spans(const SpanTasks<kThreads>& tasks, const TileGrid& grid, int n_tasks,
                                            Visit&& visit) {
  static_assert((kThreads & (kThreads - 1)) == 0, "for the binary search");
  for (auto task = static_cast<int>(threadIdx.x); task < n_tasks; task += kThreads) {
    int owner = 0;  // number of threads whose rows all come before
#pragma unroll
    for (int step = kThreads / 2; step > 0; step /= 2) {
      if (tasks.up_to[owner + step - 1] <= task) owner += step;
    }
    const TileRows& of_owner = tasks.rows[owner];
    const std::int32_t row = of_owner.begin + task - (owner > 0 ? tasks.up_to[owner - 1] : 0);
    const Span span = of_owner.span(with_known_tiles(grid), row);
    if (span.begin < span.end) visit(owner, row, span);
  }
}

/// A block's own tile counters in shared memory, so that it adds to a tile's counter in global memory only once. In
/// global memory, atomics to one counter wait for each other. Tile t uses index t % kSlots, unless another tile took it
/// first. Then its atomics go to global memory.
struct BlockCounters {
  static constexpr int kSlots = 1024;
  std::int32_t tile[kSlots], count[kSlots];

  __device__ __forceinline__ void reset(int n_threads) {
    for (int slot = static_cast<int>(threadIdx.x); slot < kSlots; slot += n_threads) tile[slot] = -1, count[slot] = 0;
  }
  /// Returns the counter of tile `index`, or null if another tile uses its index.
  __device__ __forceinline__ std::int32_t* take(std::int32_t index) {
    const int slot = index % kSlots;
    const std::int32_t before = atomicCAS(tile + slot, -1, index);
    return before == -1 || before == index ? count + slot : nullptr;
  }
  /// The same without creating a counter. Must be called after a barrier that follows the last take().
  __device__ __forceinline__ std::int32_t* find(std::int32_t index) {
    return tile[index % kSlots] == index ? count + index % kSlots : nullptr;
  }
};

/// Counts the splats of a block in `n_splats` and, if they are drawn, in the list lengths of their tiles. `rows`: see
/// share_spans(). Barriers: one. Drawing takes two more and those of the scan. May be called again immediately, because
/// the last barrier follows all reads of shared memory.
template <int kThreads>
__device__ __forceinline__ void count_splats(SpanTasks<kThreads>& tasks, const TileGrid& grid, const TileRows& rows,
                                             std::int32_t* list_growth, std::int64_t* n_splats) {
  if (list_growth != nullptr) {
    __shared__ BlockCounters counters;
    counters.reset(kThreads);
    const int n_tasks = share_spans(tasks, rows);  // its barriers also cover the reset of the counters
    const auto add = [&](std::int32_t tile, std::int32_t value) {
      std::int32_t* const own = counters.take(tile);
      atomicAdd(own != nullptr ? own : list_growth + kCounterStride * tile, value);
    };
    visit_spans(tasks, grid, n_tasks, [&](int, std::int32_t row, Span span) {
      add(row * grid.columns + span.begin, 1);
      add(row * grid.columns + span.end, -1);
    });
    __syncthreads();  // all splats are counted
    for (int slot = static_cast<int>(threadIdx.x); slot < BlockCounters::kSlots; slot += kThreads) {
      const std::int32_t count = counters.count[slot];
      if (count != 0) atomicAdd(list_growth + kCounterStride * counters.tile[slot], count);
    }
  }
  const int n = __syncthreads_count(rows.begin < rows.end);
  if (threadIdx.x == 0 && n > 0) {
    atomicAdd(reinterpret_cast<unsigned long long*>(n_splats), static_cast<unsigned long long>(n));
  }
}

}  // namespace b3dgs::cuda
