// Colour of one splat, for the projection and for implementations of ColorPass.
#pragma once

#include "raster/cuda/passes.h"
#include "raster/math/array_rows.h"
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

}  // namespace b3dgs::cuda
