// The exposure model on the GPU.
//   apply      a thread per pixel: row_kernels.cu
//   backward   a block of threads per kExposureBlock pixels sums its part of the transform's gradient; then one block
//              adds the parts. Both in a fixed order.
//   step       a thread per element of all transforms; then one block shifts them

#include "core/cuda_check.h"
#include "train/appearance/exposure.h"
#include "train/optimizer/adam_step.cuh"

namespace b3dgs::cuda {
namespace {

constexpr int kThreads = 256, kWarps = kThreads / 32;

template <class Real>
__device__ __forceinline__ Real sum_warp(Real value) {
  for (int offset = 16; offset > 0; offset /= 2) value += __shfl_xor_sync(0xffffffffu, value, offset);
  return value;
}

__global__ void __launch_bounds__(kThreads) exposure_backward_kernel(const ExposureArgs args) {
  __shared__ float of_warp[kWarps][kExposureSize];
  float sums[kExposureSize] = {};
  const std::int64_t begin = static_cast<std::int64_t>(blockIdx.x) * kExposureBlock;
  const std::int64_t end = begin + kExposureBlock < args.n_pixels ? begin + kExposureBlock : args.n_pixels;
  for (std::int64_t pixel = begin + threadIdx.x; pixel < end; pixel += kThreads) {
    expose_pixel_backward(args, pixel, sums);
  }
#pragma unroll
  for (int k = 0; k < kExposureSize; ++k) {
    const float sum = sum_warp(sums[k]);
    if (threadIdx.x % 32 == 0) of_warp[threadIdx.x / 32][k] = sum;
  }
  __syncthreads();  // all warps have written
  if (threadIdx.x >= kExposureSize) return;
  double sum = 0;
  for (int warp = 0; warp < kWarps; ++warp) sum += static_cast<double>(of_warp[warp][threadIdx.x]);
  args.block_sums[static_cast<std::int64_t>(blockIdx.x) * kExposureSize + threadIdx.x] = sum;
}

/// A warp per element of a transform.
__global__ void __launch_bounds__(32 * kExposureSize) exposure_sum_kernel(const ExposureArgs args) {
  const int element = static_cast<int>(threadIdx.x) / 32, lane = static_cast<int>(threadIdx.x) % 32;
  double sum = 0;
  for (std::int64_t block = lane; block < args.n_blocks(); block += 32) {
    sum += args.block_sums[block * kExposureSize + element];
  }
  sum = sum_warp(sum);
  if (lane == 0) args.transform_grad[element] = static_cast<float>(sum);
}

__global__ void __launch_bounds__(kThreads) exposure_step_kernel(const ExposureStepArgs args) {
  const std::int64_t i = static_cast<std::int64_t>(blockIdx.x) * kThreads + threadIdx.x;
  if (i >= args.adam.n) return;
  const bool has_grad = i >= args.first && i < args.first + kExposureSize;
  const float grad = has_grad ? args.transform_grad[i - args.first] : 0.0f;
  step_one(args.adam.size, grad, args.adam.param[i], args.adam.m[i], args.adam.v[i]);
}

/// A warp per element of a transform.
__global__ void __launch_bounds__(32 * kExposureSize) center_exposures_kernel(const ExposureStepArgs args) {
  const int element = static_cast<int>(threadIdx.x) / 32, lane = static_cast<int>(threadIdx.x) % 32;
  const std::int64_t n_views = args.adam.n / kExposureSize;
  double sum = 0;
  for (std::int64_t view = lane; view < n_views; view += 32) {
    sum += static_cast<double>(args.adam.param[view * kExposureSize + element]);
  }
  const float excess = mean_excess(args, element, sum_warp(sum));
  for (std::int64_t view = lane; view < n_views; view += 32) args.adam.param[view * kExposureSize + element] -= excess;
}

unsigned blocks_of(std::int64_t n, std::int64_t per_block) {
  return static_cast<unsigned>((n + per_block - 1) / per_block);
}

}  // namespace

void exposure_backward(const ExposureArgs& args, cudaStream_t stream) {
  if (args.n_pixels > 0) {
    exposure_backward_kernel<<<static_cast<unsigned>(args.n_blocks()), kThreads, 0, stream>>>(args);
    B3DGS_CUDA_CHECK_LAUNCH();
  }
  exposure_sum_kernel<<<1, 32 * kExposureSize, 0, stream>>>(args);
  B3DGS_CUDA_CHECK_LAUNCH();
}

void exposure_step(const ExposureStepArgs& args, cudaStream_t stream) {
  if (args.adam.n == 0) return;
  exposure_step_kernel<<<blocks_of(args.adam.n, kThreads), kThreads, 0, stream>>>(args);
  B3DGS_CUDA_CHECK_LAUNCH();
  center_exposures_kernel<<<1, 32 * kExposureSize, 0, stream>>>(args);
  B3DGS_CUDA_CHECK_LAUNCH();
}

}  // namespace b3dgs::cuda
