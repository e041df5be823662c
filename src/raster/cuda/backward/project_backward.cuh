// Device-side entry to gaussian_grad() (raster/math/gaussian_grad.h), for the kernel that stores gradients and for the
// one of training that passes them to the optimizer without storing them.
#pragma once

#include "raster/cuda/passes.h"
#include "raster/math/gaussian_grad.h"

namespace b3dgs::cuda {

/// Gradient by Gaussian i, which the view sees. kShDegree must equal args.sh_degree, kAntialiasing
/// args.antialiasing.
template <int kShDegree, bool kAntialiasing>
__device__ __forceinline__ GaussianGrad gaussian_grad(const ProjectBackwardCudaArgs& args, std::int64_t i) {
  const std::int32_t rank = args.rank_of_gaussian[i];
  const SplatGrad sum = args.splat_grads[rank].sum;
  const unsigned clamped = args.splats[rank].clamped;
  return b3dgs::gaussian_grad<kAntialiasing>(args.gaussians, i, make_view_transform<float>(args.view), args.view.center,
                                             kShDegree, sum, clamped);
}

}  // namespace b3dgs::cuda
