// Device functions of projection and backward projection, for their kernels, for implementations of ColorPass and for
// training's kernel that passes gradients to the optimizer without storing them.
#pragma once

#include "raster/cuda/passes.h"
#include "raster/cuda/warp.cuh"
#include "raster/math/array_rows.h"
#include "raster/math/gaussian_grad.h"
#include "raster/math/sh.h"

namespace b3dgs::cuda {

/// Red, green, blue of Gaussian i and the bits of `clamped`: the last 16 bytes of its Splat. `rest` holds its SH
/// coefficients above degree 0.
template <int kShDegree>
__device__ __forceinline__ float4 splat_color(const GaussianArrays& gaussians, Vec3f camera_center, std::int64_t i,
                                              const float* rest) {
  const ShColor<float> found =
      sh_color(kShDegree, load3(gaussians.means, i) - camera_center, gaussians.sh0 + 3 * i, rest);
  return make_float4(found.color.x, found.color.y, found.color.z, __uint_as_float(found.clamped));
}

/// Records an invalid Gaussian; the smallest index is kept.
__device__ __forceinline__ void note_invalid(ViewCounts* counts, std::int64_t i) {
  atomicMin(reinterpret_cast<unsigned long long*>(&counts->first_invalid), static_cast<unsigned long long>(i));
}

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

/// Gradient by Gaussian i, which the view sees. kShDegree must equal args.sh_degree, kAntialiasing
/// args.antialiasing.
template <int kShDegree, bool kAntialiasing>
__device__ __forceinline__ GaussianGrad gaussian_grad(const ProjectBackwardCudaArgs& args, std::int64_t i) {
  const std::int32_t rank = args.splat_of_gaussian[i];
  const SplatGrad sum = args.splat_grads[rank].sum;
  const unsigned clamped = args.splats[rank].clamped;
  return b3dgs::gaussian_grad<kAntialiasing>(args.gaussians, i, make_view_transform<float>(args.view), args.view.center,
                                             kShDegree, sum, clamped);
}

}  // namespace b3dgs::cuda
