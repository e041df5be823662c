// Gradient with respect to the camera's pose, for pose refinement. It runs between the backward blend and the
// projection's backward pass, so that the latter, which training fuses with Adam, is the same with and without it.
//   Grid: a thread per splat, up to kCameraGradientParts blocks; then each thread takes several splats. A second
//     kernel, of one block, adds the sums of the blocks.
//   Shared memory: a sum per warp.
//   Barriers: one in the first kernel, one per halving in the second.
// All sums are in double and in an order that follows from the number of splats alone.

#include "raster/cuda/launch.cuh"
#include "raster/cuda/passes.h"
#include "raster/cuda/warp.cuh"
#include "raster/math/camera_grad.h"

namespace b3dgs::cuda {
namespace {

constexpr int kThreads = 128;
constexpr int kWarps = kThreads / kWarpSize;

template <int kShDegree, bool kAntialiasing>
__global__ void __launch_bounds__(kThreads) camera_gradient_kernel(const __grid_constant__ CameraGradientArgs args) {
  __shared__ double warp_sums[kWarps][kCameraGradients];
  const ProjectBackwardCudaArgs& backward = args.backward;
  const ViewTransform<float> view = make_view_transform<float>(backward.view);
  double sums[kCameraGradients]{};
  for (std::int64_t m = static_cast<std::int64_t>(blockIdx.x) * kThreads + threadIdx.x; m < args.n_splats;
       m += static_cast<std::int64_t>(gridDim.x) * kThreads) {
    const Splat& splat = backward.splats[m];
    const CameraGrad part = camera_grad<kAntialiasing>(backward.gaussians, splat.gaussian, view, backward.view.center,
                                                       kShDegree, backward.splat_grads[m].sum, splat.clamped);
    const float values[kCameraGradients]{part.rotation.x,    part.rotation.y,    part.rotation.z,
                                         part.translation.x, part.translation.y, part.translation.z};
#pragma unroll
    for (int k = 0; k < kCameraGradients; ++k) sums[k] += values[k];
  }
#pragma unroll
  for (int k = 0; k < kCameraGradients; ++k) {
#pragma unroll
    for (int offset = kWarpSize / 2; offset > 0; offset /= 2) {
      sums[k] += __shfl_xor_sync(kFullWarp, sums[k], offset);
    }
    if (lane_id() == 0) warp_sums[threadIdx.x / kWarpSize][k] = sums[k];
  }
  __syncthreads();  // all warps' sums are in shared memory
  if (threadIdx.x < kCameraGradients) {
    double sum = 0;
    for (int warp = 0; warp < kWarps; ++warp) sum += warp_sums[warp][threadIdx.x];
    args.parts[static_cast<std::int64_t>(blockIdx.x) * kCameraGradients + threadIdx.x] = sum;
  }
}

__global__ void __launch_bounds__(kThreads) sum_parts_kernel(const double* parts, int n_parts, double* out) {
  __shared__ double sums[kCameraGradients][kThreads];
  for (int k = 0; k < kCameraGradients; ++k) {
    double sum = 0;
    for (int part = static_cast<int>(threadIdx.x); part < n_parts; part += kThreads) {
      sum += parts[kCameraGradients * part + k];
    }
    sums[k][threadIdx.x] = sum;
  }
  for (int half = kThreads / 2; half > 0; half /= 2) {
    __syncthreads();  // the sums that are added are complete
    if (static_cast<int>(threadIdx.x) < half) {
      for (int k = 0; k < kCameraGradients; ++k) sums[k][threadIdx.x] += sums[k][threadIdx.x + half];
    }
  }
  if (threadIdx.x == 0) {
    for (int k = 0; k < kCameraGradients; ++k) out[k] = sums[k][0];
  }
}

}  // namespace

void camera_gradient(const CameraGradientArgs& args, const LaunchContext& context) {
  const std::int64_t n_wanted = (args.n_splats + kThreads - 1) / kThreads;
  const int blocks = static_cast<int>(n_wanted < kCameraGradientParts ? n_wanted : kCameraGradientParts);
  if (blocks > 0) {
    with_sh_degree(args.backward.sh_degree, [&](auto degree) {
      const auto kernel = args.backward.antialiasing ? camera_gradient_kernel<degree.value, true>
                                                     : camera_gradient_kernel<degree.value, false>;
      kernel<<<blocks, kThreads, 0, context.stream>>>(args);
    });
    B3DGS_CUDA_CHECK_LAUNCH();
  }
  sum_parts_kernel<<<1, kThreads, 0, context.stream>>>(args.parts, blocks, args.out);
  B3DGS_CUDA_CHECK_LAUNCH();
}

}  // namespace b3dgs::cuda
