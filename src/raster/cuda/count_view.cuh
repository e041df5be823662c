// Numbers of splats and pairs of a view (ViewCounts), for kernels with a thread per Gaussian or splat.
#pragma once

#include "raster/cuda/passes.h"
#include "raster/cuda/warp.cuh"

namespace b3dgs::cuda {

/// Adds this thread's splat, which touches n_tiles tiles; 0 if it has none. Warps add to the block's sums, which are in
/// shared memory and 0 at the start, and one thread adds these to the view's: two global atomics per block. All threads
/// of the block must call it. Barriers: one.
__device__ __forceinline__ void count_splat(std::int32_t n_tiles, unsigned long long& block_splats,
                                            unsigned long long& block_pairs, ViewCounts* counts) {
  // A splat touches at most all tiles, so a warp's sum fits 32 bits up to 2^27 tiles.
  const int seen = __popc(__ballot_sync(kFullWarp, n_tiles > 0));
  const unsigned pairs = warp_sum(static_cast<unsigned>(n_tiles));
  if (lane_id() == 0 && seen > 0) {
    atomicAdd(&block_splats, static_cast<unsigned long long>(seen));
    atomicAdd(&block_pairs, static_cast<unsigned long long>(pairs));
  }
  __syncthreads();
  if (threadIdx.x == 0 && block_splats > 0) {
    atomicAdd(reinterpret_cast<unsigned long long*>(&counts->n_splats), block_splats);
    atomicAdd(reinterpret_cast<unsigned long long*>(&counts->n_pairs), block_pairs);
  }
}

}  // namespace b3dgs::cuda
