// The rows of tiles that the splats of a block touch, shared evenly among its threads: a splat may touch one row, and
// its neighbour a hundred.
//
//   thread        0     1     2     3
//   rows          3     0     1     2          of its splat
//   task        0 1 2        3    4 5          of threads 0, 1, 2, 3, 0, 1
#pragma once

#include <cub/block/block_scan.cuh>

#include "raster/cuda/passes.h"
#include "raster/math/tiling.h"

namespace b3dgs::cuda {

/// Shared memory of visit_spans().
template <int kThreads>
struct SpanTasks {
  TileRows rows[kThreads];
  int up_to[kThreads];  // number of rows of the threads up to this one
  typename cub::BlockScan<int, kThreads>::TempStorage scan;
};

/// The row of arrays of a thread, which may be past the last. Blocks take runs of rows that are far apart: neighbours
/// often have similar sizes, and a block with only large splats would finish last.
template <int kThreads>
__device__ __forceinline__ std::int64_t spread_row() {
  constexpr int kRun = 8;  // of floats, a memory sector
  const auto thread = static_cast<std::int64_t>(threadIdx.x);
  return (thread / kRun * gridDim.x + blockIdx.x) * kRun + thread % kRun;
}

/// Calls visit(thread, row, span) for each row of tiles that the splat of a thread touches. `rows`: of this thread's
/// splat, none where rows.begin == rows.end. All threads of the block must call it. Barriers: one, and those of the
/// scan.
template <int kThreads, class Visit>
__device__ __forceinline__ void visit_spans(SpanTasks<kThreads>& tasks, const TileGrid& grid, const TileRows& rows,
                                            Visit&& visit) {
  static_assert((kThreads & (kThreads - 1)) == 0, "for the binary search");
  int up_to = 0, n_tasks = 0;
  cub::BlockScan<int, kThreads>(tasks.scan).InclusiveSum(max(rows.end - rows.begin, 0), up_to, n_tasks);
  tasks.rows[threadIdx.x] = rows;
  tasks.up_to[threadIdx.x] = up_to;
  __syncthreads();  // what all threads have
  for (auto task = static_cast<int>(threadIdx.x); task < n_tasks; task += kThreads) {
    int owner = 0;  // number of threads whose rows are all in front
#pragma unroll
    for (int step = kThreads / 2; step > 0; step /= 2) {
      if (tasks.up_to[owner + step - 1] <= task) owner += step;
    }
    const TileRows& of_owner = tasks.rows[owner];
    const std::int32_t row = of_owner.begin + task - (owner > 0 ? tasks.up_to[owner - 1] : 0);
    const TileSpan span = of_owner.span(grid, row);
    if (span.begin < span.end) visit(owner, row, span);
  }
}

/// Adds the splats of a block to the lengths of their tiles' lists. `rows`: as in visit_spans().
template <int kThreads>
__device__ __forceinline__ void count_spans(SpanTasks<kThreads>& tasks, const TileGrid& grid, const TileRows& rows,
                                            std::int32_t* list_growth) {
  visit_spans(tasks, grid, rows, [&](int, std::int32_t row, TileSpan span) {
    atomicAdd(list_growth + kCounterStride * (row * grid.columns + span.begin), 1);
    atomicAdd(list_growth + kCounterStride * (row * grid.columns + span.end), -1);
  });
}

}  // namespace b3dgs::cuda
