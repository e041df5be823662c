// Projection backward of all views of a step and Adam in one kernel. Counterpart of gaussian_step.cu, for steps of
// several views (--batch).
//   Grid: a thread per Gaussian, for all parameters but the SH coefficients beyond degree 0. Those of the Gaussians
//     that any view sees are stepped by the block together, coalesced.
//   Shared memory: the block's gradients of these coefficients, up to 45 floats per Gaussian.
//   Barriers: one, between gradients and step of these coefficients, which the gradients of the means depend on.

#include "raster/cuda/launch.cuh"
#include "train/optimizer/adam_step.cuh"
#include "train/optimizer/batch/batch_step_cuda.h"

namespace b3dgs::cuda {
namespace {

constexpr int kThreads = 128;

template <int kFloats>
__device__ __forceinline__ void step_row(const AdamArgs& args, const AdamRule& rule, std::int64_t row,
                                         const float (&grad)[kFloats]) {
#pragma unroll
  for (int k = 0; k < kFloats; ++k) {
    const std::int64_t at = kFloats * row + k;
    step_one(args.size, rule, grad[k], args.param[at], args.m[at], args.v[at]);
  }
}

template <int kShDegree, bool kAntialiasing>
__global__ void __launch_bounds__(kThreads) step_batch_kernel(const __grid_constant__ BatchStepArgs args) {
  constexpr int kActive = rest_floats(kShDegree);
  __shared__ float rests[kThreads * kActive + 1];
  __shared__ bool is_seen[kThreads];
  const std::int64_t first_row = static_cast<std::int64_t>(blockIdx.x) * kThreads, i = first_row + threadIdx.x;
  const float scale = 1.0f / static_cast<float>(args.grad.n_views);
  float* const own_rest = rests + threadIdx.x * kActive;
  for (int k = 0; k < kActive; ++k) own_rest[k] = 0;
  is_seen[threadIdx.x] = false;
  if (i < args.grad.gaussians.n_gaussians) {
    const BatchGrad grad = batch_grad<kAntialiasing>(args.grad, i, kShDegree, scale, own_rest);
    is_seen[threadIdx.x] = grad.is_seen;
    if (kActive > 0 && grad.is_seen) {
      reinterpret_cast<float4*>(args.updates + i)[0] = make_float4(0, 0, 0, __int_as_float(args.n_deferred + 1));
    }
    step_row<3>(args.adam[0], args.rule, i, {grad.mean.x, grad.mean.y, grad.mean.z});
    step_row<3>(args.adam[1], args.rule, i, {grad.log_scales.x, grad.log_scales.y, grad.log_scales.z});
    step_row<4>(args.adam[2], args.rule, i, {grad.quat.x, grad.quat.y, grad.quat.z, grad.quat.w});
    step_row<1>(args.adam[3], args.rule, i, {grad.logit_opacity});
    step_row<3>(args.adam[4], args.rule, i, {grad.sh0.x, grad.sh0.y, grad.sh0.z});
  }
  if (kActive == 0) return;
  __syncthreads();  // gradients of the block are complete, and the coefficients have been read
  const AdamArgs& adam = args.adam[5];
  const int n_rest = rest_floats(args.grad.gaussians.sh_degree_max);
  for (int k = static_cast<int>(threadIdx.x); k < kThreads * kActive; k += kThreads) {
    const int row = k / (kActive > 0 ? kActive : 1), column = k - row * kActive;
    if (!is_seen[row]) continue;
    const std::int64_t at = (first_row + row) * n_rest + column;
    step_one(adam.size, args.rule, scale * rests[k], adam.param[at], adam.m[at], adam.v[at]);
  }
}

}  // namespace

void step_batch(const BatchStepArgs& args, const LaunchContext& context) {
  const std::int64_t n = args.grad.gaussians.n_gaussians;
  if (n == 0) return;
  const auto blocks = static_cast<unsigned>((n + kThreads - 1) / kThreads);
  with_sh_degree(args.grad.sh_degree, [&](auto degree) {
    const auto kernel =
        args.grad.antialiasing ? step_batch_kernel<degree.value, true> : step_batch_kernel<degree.value, false>;
    kernel<<<blocks, kThreads, 0, context.stream>>>(args);
  });
  B3DGS_CUDA_CHECK_LAUNCH();
}

}  // namespace b3dgs::cuda
