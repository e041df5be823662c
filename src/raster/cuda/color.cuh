// Colours from harmonics, for blocks that own a run of Gaussians each. Harmonics are up to 45 floats a Gaussian, and
// only those of seen ones are wanted: a block lists these, copies their rows to shared memory side by side, and then a
// thread finds the colour of each.
#pragma once

#include "raster/cuda/passes.h"
#include "raster/cuda/rows.cuh"
#include "raster/cuda/warp.cuh"
#include "raster/sh.h"

namespace b3dgs::cuda {

/// The rows of a block that there is work for, without gaps; in shared memory.
template <int kThreads>
struct RowList {
  int rows[kThreads];
  int of_warp[kThreads / kWarpSize];  // how many of each warp's
};

struct ListedRow {
  int place;   // of the thread's row in the list, or -1
  int n_rows;  // in the list
};

/// Lists the rows of threads that say so. For all threads of the block; the list can be read after its next barrier.
template <int kThreads>
__device__ __forceinline__ ListedRow list_row(RowList<kThreads>& list, bool is_listed) {
  const auto thread = static_cast<int>(threadIdx.x), own_warp = thread / kWarpSize;
  const unsigned listed = __ballot_sync(kFullWarp, is_listed);
  if (lane_id() == 0) list.of_warp[own_warp] = __popc(listed);
  __syncthreads();
  ListedRow result{__popc(listed & ((1u << lane_id()) - 1)), 0};
#pragma unroll
  for (int warp = 0; warp < kThreads / kWarpSize; ++warp) {
    if (warp < own_warp) result.place += list.of_warp[warp];
    result.n_rows += list.of_warp[warp];
  }
  if (is_listed) {
    list.rows[result.place] = thread;
  } else {
    result.place = -1;
  }
  return result;
}

/// Red, green and blue of Gaussian i and, as bits, which were clamped: the last word of its splat. `rest` has its
/// harmonics beyond degree 0.
template <int kShDegree>
__device__ __forceinline__ float4 splat_color(const GaussianArrays& gaussians, Vec3f camera_center, std::int64_t i,
                                              const float* rest) {
  const ShColor<float> found =
      sh_color(kShDegree, load3(gaussians.means, i) - camera_center, gaussians.sh0 + 3 * i, rest);
  return make_float4(found.color.x, found.color.y, found.color.z, __uint_as_float(found.clamped));
}

/// Notes a Gaussian whose projection or colour is not finite; the first one counts.
__device__ __forceinline__ void note_not_finite(ViewCounts* counts, std::int64_t i) {
  atomicMin(reinterpret_cast<unsigned long long*>(&counts->not_finite), static_cast<unsigned long long>(i));
}

}  // namespace b3dgs::cuda
