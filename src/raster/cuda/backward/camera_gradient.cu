// Gradient with respect to the camera's pose, for pose refinement. It runs between the backward blend and the backward
// projection, so that the latter, which training fuses with Adam, is the same with and without it.
//   Grid: a thread per splat, up to kCameraGradientParts blocks. Beyond that, each thread processes several splats. A
//     second kernel, of one block, adds the sums of the blocks.
//   Shared memory: a sum per warp.
//   Barriers: one in the first kernel, one per halving in the second.
// For splats rendered elsewhere, the first kernel also stores the contribution of each splat. add_parts_kernel then
// replaces the first kernel and adds these numbers in the same order.
// All sums are in double, in an order that depends only on the number of splats.

#include <algorithm>

#include "raster/cuda/launch.cuh"
#include "raster/cuda/project.cuh"
#include "raster/cuda/warp.cuh"
#include "raster/math/gaussian_grad.h"

namespace b3dgs::cuda {
namespace {

constexpr int kThreads = 128;
constexpr int kWarps = kThreads / kWarpSize;

/// Writes the sum over the threads of the block.
__device__ __forceinline__ void add_block(double (&sums)[kCameraGradients], double* parts) {
  __shared__ double warp_sums[kWarps][kCameraGradients];
#pragma unroll
  for (int k = 0; k < kCameraGradients; ++k) {
#pragma unroll
    for (int offset = kWarpSize / 2; offset > 0; offset /= 2) {
      sums[k] += __shfl_xor_sync(kFullWarp, sums[k], offset);
    }
    if (lane_id() == 0) warp_sums[threadIdx.x / kWarpSize][k] = sums[k];
  }
  __syncthreads();  // the sums of all warps are in shared memory
  if (threadIdx.x < kCameraGradients) {
    double sum = 0;
    for (int warp = 0; warp < kWarps; ++warp) sum += warp_sums[warp][threadIdx.x];
    parts[static_cast<std::int64_t>(blockIdx.x) * kCameraGradients + threadIdx.x] = sum;
  }
}

template <int kShDegree, bool kAntialiasing, class Lens>
__global__ void __launch_bounds__(kThreads) camera_gradient_kernel(const __grid_constant__ CameraGradientArgs args) {
  const ProjectBackwardCudaArgs& backward = args.backward;
  const ViewTransform<float> view = make_view_transform<float>(backward.view);
  double sums[kCameraGradients]{};
  for (std::int64_t m = own_row<kThreads>(); m < args.n_splats; m += static_cast<std::int64_t>(gridDim.x) * kThreads) {
    const std::int64_t row = args.seen != nullptr ? args.seen[m] : m;
    if (args.seen != nullptr && row >= backward.gaussians.n_gaussians) break;  // second splats are last
    const Splat& splat = backward.splats[row];
    const CameraGrad part =
        camera_grad<kAntialiasing>(backward.gaussians, splat.gaussian, view, lens_of<Lens>(backward.view),
                                   backward.view.center, kShDegree, backward.splat_grads[row].sum, splat.clamped);
    const float values[kCameraGradients]{part.rotation.x,    part.rotation.y,    part.rotation.z,
                                         part.translation.x, part.translation.y, part.translation.z};
#pragma unroll
    for (int k = 0; k < kCameraGradients; ++k) sums[k] += values[k];
    if (args.splat_parts != nullptr) {
#pragma unroll
      for (int k = 0; k < kCameraGradients; ++k) args.splat_parts[m * kCameraGradients + k] = values[k];
    }
  }
  add_block(sums, args.parts);
}

__global__ void __launch_bounds__(kThreads)
    add_parts_kernel(const float* splat_parts, std::int64_t n_splats, double* parts) {
  double sums[kCameraGradients]{};
  for (std::int64_t m = own_row<kThreads>(); m < n_splats; m += static_cast<std::int64_t>(gridDim.x) * kThreads) {
#pragma unroll
    for (int k = 0; k < kCameraGradients; ++k) sums[k] += splat_parts[m * kCameraGradients + k];
  }
  add_block(sums, parts);
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
    __syncthreads();  // the sums of the previous round are complete
    if (static_cast<int>(threadIdx.x) < half) {
      for (int k = 0; k < kCameraGradients; ++k) sums[k][threadIdx.x] += sums[k][threadIdx.x + half];
    }
  }
  if (threadIdx.x == 0) {
    for (int k = 0; k < kCameraGradients; ++k) out[k] = sums[k][0];
  }
}

int blocks_for(std::int64_t n_splats) {
  return static_cast<int>(std::min<std::int64_t>(n_blocks(n_splats, kThreads), kCameraGradientParts));
}

}  // namespace

void camera_gradient(const CameraGradientArgs& args, const LaunchContext& context) {
  const ProjectBackwardCudaArgs& backward = args.backward;
  const int blocks = blocks_for(args.n_splats);
  with_constants(backward.sh_degree, backward.antialiasing, backward.view.lens,
                 [&](auto degree, auto antialiasing, auto lens) {
                   launch_blocks(camera_gradient_kernel<degree.value, antialiasing.value, decltype(lens)>, blocks,
                                 kThreads, context, args);
                 });
  launch_blocks(sum_parts_kernel, 1, kThreads, context, args.parts, blocks, args.out);
}

void sum_camera_parts(const float* splat_parts, std::int64_t n_splats, double* parts, double* out,
                      const LaunchContext& context) {
  const int blocks = blocks_for(n_splats);
  launch_blocks(add_parts_kernel, blocks, kThreads, context, splat_parts, n_splats, parts);
  launch_blocks(sum_parts_kernel, 1, kThreads, context, parts, blocks, out);
}

}  // namespace b3dgs::cuda
