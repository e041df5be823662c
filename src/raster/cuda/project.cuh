// Device functions of projection and backward projection. Used by their kernels, by implementations of ColorPass, and
// by training's kernel that passes gradients to the optimizer without storing them.
#pragma once

#include <type_traits>

#include "raster/cuda/passes.h"
#include "raster/cuda/warp.cuh"
#include "raster/math/array_rows.h"
#include "raster/math/gaussian_grad.h"
#include "raster/math/sh.h"

namespace b3dgs::cuda {

/// Returns red, green and blue of Gaussian i and the bits of `clamped`, which are the last 16 bytes of its Splat.
/// `rest` points to its SH coefficients above degree 0.
template <int kShDegree>
__device__ __forceinline__ float4 splat_color(const GaussianArrays& gaussians, Vec3f camera_center, std::int64_t i,
                                              const float* rest) {
  const ShColor<float> found =
      sh_color(kShDegree, load3(gaussians.means, i) - camera_center, gaussians.sh0 + 3 * i, rest);
  return make_float4(found.color.x, found.color.y, found.color.z, __uint_as_float(found.clamped));
}

/// Reports an invalid Gaussian. The smallest index wins (-1 is the largest unsigned number).
__device__ __forceinline__ void note_invalid(ViewCounts* counts, std::int64_t i) {
  atomicMin(reinterpret_cast<unsigned long long*>(&counts->first_invalid), static_cast<unsigned long long>(i));
}

/// Returns the argument for the instance of a kernel for `Lens`: a Pinhole or the ViewLens of the view.
template <class Lens>
__device__ __forceinline__ Lens lens_of(const CameraView& view) {
  if constexpr (std::is_same_v<Lens, Pinhole>) {
    return {};
  } else {
    return view.lens;
  }
}

/// Returns the gradient of Gaussian i, which must be visible. kShDegree must equal args.sh_degree, and kAntialiasing
/// args.antialiasing.
template <int kShDegree, bool kAntialiasing, class Lens>
__device__ __forceinline__ GaussianGrad gaussian_grad(const ProjectBackwardCudaArgs& args, std::int64_t i) {
  const SplatGrad sum = args.splat_grads[i].sum;
  const unsigned clamped = args.splats[i].clamped;
  return b3dgs::gaussian_grad<kAntialiasing>(args.gaussians, i, make_view_transform<float>(args.view),
                                             lens_of<Lens>(args.view), args.view.center, kShDegree, sum, clamped);
}

}  // namespace b3dgs::cuda
