// The background's passes on a GPU.
//   Forward: a thread per pixel.
//   Backward, kernel 1: a block per part of 4096 pixels, 16 per thread. A thread keeps its 75 sums in registers; warps
//     sum them with shuffles and the block in shared memory, into a row per part.
//   Backward, kernel 2: a block per coefficient sums the rows. The order is fixed, so that results are reproducible.

#include "core/cuda_check.h"
#include "raster/cuda/warp.cuh"
#include "train/background/background_cuda.h"
#include "train/optimizer/adam_step.cuh"

namespace b3dgs::cuda {
namespace {

constexpr int kThreads = 256, kWarps = kThreads / kWarpSize;
constexpr int kSumThreads = 128, kSumWarps = kSumThreads / kWarpSize;

template <int kDegree>
__global__ void __launch_bounds__(kThreads) add_background_kernel(const __grid_constant__ BackgroundArgs args) {
  const std::int64_t p = static_cast<std::int64_t>(blockIdx.x) * kThreads + threadIdx.x;
  if (p < std::int64_t{args.view.width} * args.view.height) add_background_at<kDegree>(args, p);
}

template <int kDegree>
__global__ void __launch_bounds__(kThreads)
    background_gradient_kernel(const __grid_constant__ BackgroundGradArgs args) {
  constexpr int kSums = 3 * background_coefficients(kDegree);
  __shared__ float warp_sums[kWarps][kSums];
  const std::int64_t n_pixels = std::int64_t{args.view.width} * args.view.height;
  const std::int64_t begin = blockIdx.x * kBackgroundPart;
  const std::int64_t end = begin + kBackgroundPart < n_pixels ? begin + kBackgroundPart : n_pixels;
  float sums[kSums];
#pragma unroll
  for (int i = 0; i < kSums; ++i) sums[i] = 0;
  for (std::int64_t p = begin + threadIdx.x; p < end; p += kThreads) background_grad_at<kDegree>(args, p, sums);
#pragma unroll
  for (int i = 0; i < kSums; ++i) {
    const float sum = warp_sum(sums[i]);
    if (lane_id() == 0) warp_sums[threadIdx.x / kWarpSize][i] = sum;
  }
  __syncthreads();  // all warps have written their sums
  for (int i = static_cast<int>(threadIdx.x); i < kSums; i += kThreads) {
    float sum = 0;
    for (int warp = 0; warp < kWarps; ++warp) sum += warp_sums[warp][i];
    args.parts[static_cast<std::int64_t>(blockIdx.x) * kSums + i] = sum;
  }
}

__global__ void __launch_bounds__(kSumThreads)
    sum_parts_kernel(const float* parts, std::int64_t n_parts, float* sums_out) {
  __shared__ float warp_sums[kSumWarps];
  float sum = 0;
  for (std::int64_t part = threadIdx.x; part < n_parts; part += kSumThreads)
    sum += parts[part * gridDim.x + blockIdx.x];
  sum = warp_sum(sum);
  if (lane_id() == 0) warp_sums[threadIdx.x / kWarpSize] = sum;
  __syncthreads();  // all warps have written their sums
  if (threadIdx.x != 0) return;
  float whole = 0;
  for (const float own : warp_sums) whole += own;
  sums_out[blockIdx.x] = whole;
}

__global__ void step_background_kernel(const __grid_constant__ AdamArgs args) {
  const std::int64_t i = threadIdx.x;
  if (i < args.n) step_one(args.size, args.grad[i], args.param[i], args.m[i], args.v[i]);
}

__global__ void step_background_along_mean_kernel(const __grid_constant__ AdamArgs args,
                                                  const __grid_constant__ AdamRule rule) {
  const std::int64_t i = threadIdx.x;
  if (i < args.n) step_one(args.size, rule, args.grad[i], args.param[i], args.m[i], args.v[i]);
}

}  // namespace

void add_background(const BackgroundArgs& args, cudaStream_t stream) {
  const std::int64_t n = std::int64_t{args.view.width} * args.view.height;
  const auto blocks = static_cast<unsigned>((n + kThreads - 1) / kThreads);
  const auto kernel = args.degree == 0 ? add_background_kernel<0> : add_background_kernel<kBackgroundDegree>;
  kernel<<<blocks, kThreads, 0, stream>>>(args);
  B3DGS_CUDA_CHECK_LAUNCH();
}

void background_gradient(const BackgroundGradArgs& args, cudaStream_t stream) {
  const std::int64_t n_parts = background_parts(args.view);
  const auto kernel = args.degree == 0 ? background_gradient_kernel<0> : background_gradient_kernel<kBackgroundDegree>;
  kernel<<<static_cast<unsigned>(n_parts), kThreads, 0, stream>>>(args);
  B3DGS_CUDA_CHECK_LAUNCH();
  const int n_sums = 3 * background_coefficients(args.degree);
  sum_parts_kernel<<<n_sums, kSumThreads, 0, stream>>>(args.parts, n_parts, args.grad_coefficients);
  B3DGS_CUDA_CHECK_LAUNCH();
}

void step_background(const AdamArgs& args, cudaStream_t stream) {
  static_assert(3 * kBackgroundCoefficients <= kThreads, "a thread per coefficient");
  step_background_kernel<<<1, kThreads, 0, stream>>>(args);
  B3DGS_CUDA_CHECK_LAUNCH();
}

void step_background(const AdamArgs& args, const AdamRule& rule, cudaStream_t stream) {
  step_background_along_mean_kernel<<<1, kThreads, 0, stream>>>(args, rule);
  B3DGS_CUDA_CHECK_LAUNCH();
}

}  // namespace b3dgs::cuda
