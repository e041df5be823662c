// Projection backward and Adam in one kernel: a thread for each Gaussian finds its gradient and takes the step of the
// fourteen parameters without harmonics. Those of the harmonics, up to 45 floats a Gaussian, wait in shared memory,
// from where the block takes their step side by side, 16 bytes a thread.
//
// A step has to read and write parameters and moments, 24 bytes a float; gradients that went through memory would add
// 8. Gaussians that the view does not see have a step as well, for their moments go on.

#include "raster/cuda/launch.cuh"
#include "raster/cuda/project_backward.cuh"
#include "train/cuda/gaussian_step_cuda.h"

namespace b3dgs::cuda {
namespace {

constexpr int kThreads = 128;
constexpr std::size_t kRestGroup = 5;  // of AdamGroups

__device__ __forceinline__ void step_one(const AdamArgs& args, float grad, float& param, float& m, float& v) {
  constexpr auto kBeta1 = static_cast<float>(kAdamBeta1), kBeta2 = static_cast<float>(kAdamBeta2);
  m = kBeta1 * m + (1 - kBeta1) * grad;
  v = kBeta2 * v + (1 - kBeta2) * grad * grad;
  param -= args.step_size * m / (sqrtf(v) * args.inverse_root_bias2 + static_cast<float>(kAdamEpsilon));
}

/// `kFloats` of one Gaussian. All is read before anything is written.
template <int kFloats>
__device__ __forceinline__ void step_row(const AdamArgs& args, std::int64_t row, const float (&grad)[kFloats]) {
  float param[kFloats], m[kFloats], v[kFloats];
#pragma unroll
  for (int k = 0; k < kFloats; ++k) {
    param[k] = args.param[kFloats * row + k];
    m[k] = args.m[kFloats * row + k];
    v[k] = args.v[kFloats * row + k];
  }
#pragma unroll
  for (int k = 0; k < kFloats; ++k) {
    step_one(args, grad[k], param[k], m[k], v[k]);
    args.param[kFloats * row + k] = param[k];
    args.m[kFloats * row + k] = m[k];
    args.v[kFloats * row + k] = v[k];
  }
}

__device__ __forceinline__ void step_four(const AdamArgs& args, std::int64_t first, float4 grad) {
  float4 param = *reinterpret_cast<const float4*>(args.param + first);
  float4 m = *reinterpret_cast<const float4*>(args.m + first), v = *reinterpret_cast<const float4*>(args.v + first);
  step_one(args, grad.x, param.x, m.x, v.x);
  step_one(args, grad.y, param.y, m.y, v.y);
  step_one(args, grad.z, param.z, m.z, v.z);
  step_one(args, grad.w, param.w, m.w, v.w);
  *reinterpret_cast<float4*>(args.param + first) = param;
  *reinterpret_cast<float4*>(args.m + first) = m;
  *reinterpret_cast<float4*>(args.v + first) = v;
}

/// All but the harmonics beyond degree 0, whose gradients go to `rest`.
template <int kShDegree>
__device__ __forceinline__ void step_gaussian(const GaussianStepArgs& args, std::int64_t i, float* rest) {
  GaussianGrad grad{};
  float sh0[3] = {0, 0, 0};
  if (args.backward.radii[i] > 0) {
    grad = gaussian_grad<kShDegree>(args.backward, i, sh0, rest);
  } else {
    for (int k = 0; k < rest_floats(kShDegree); ++k) rest[k] = 0;
  }
  reinterpret_cast<float2*>(args.backward.grad.means2d)[i] = make_float2(grad.mean2d.x, grad.mean2d.y);
  step_row<3>(args.adam[0], i, {grad.mean.x, grad.mean.y, grad.mean.z});
  step_row<3>(args.adam[1], i, {grad.log_scales.x, grad.log_scales.y, grad.log_scales.z});
  step_four(args.adam[2], 4 * i, make_float4(grad.quat.x, grad.quat.y, grad.quat.z, grad.quat.w));
  step_row<1>(args.adam[3], i, {grad.logit_opacity});
  step_row<3>(args.adam[4], i, sh0);
}

/// Harmonics beyond degree 0 of a block's Gaussians, as far as they are learned by now: kActive of the n_rest floats
/// that are stored for each. `rests` [n_rows, kActive] has their gradients.
template <int kActive>
__device__ __forceinline__ void step_rests(const AdamArgs& args, std::int64_t first_row, int n_rows, int n_rest,
                                           const float* rests) {
  const int thread = static_cast<int>(threadIdx.x), n_floats = n_rows * kActive;
  if (n_rest == kActive) {
    const std::int64_t first = first_row * kActive;
#pragma unroll 2
    for (int k = thread; k < n_floats / 4; k += kThreads) {
      step_four(args, first + 4 * k, reinterpret_cast<const float4*>(rests)[k]);
    }
    for (int k = n_floats / 4 * 4 + thread; k < n_floats; k += kThreads) {
      step_one(args, rests[k], args.param[first + k], args.m[first + k], args.v[first + k]);
    }
    return;
  }
  // Degrees that are not learned yet have never had a gradient: their moments are 0, and a step would leave them alone.
  for (int k = thread; k < n_floats; k += kThreads) {
    const std::int64_t at = (first_row + k / kActive) * n_rest + k % kActive;
    step_one(args, rests[k], args.param[at], args.m[at], args.v[at]);
  }
}

template <int kShDegree>
__global__ void __launch_bounds__(kThreads)
    step_gaussians_kernel(const __grid_constant__ GaussianStepArgs args, int n_rest) {
  constexpr int kActive = rest_floats(kShDegree);
  __shared__ alignas(16) float rests[kThreads * (kActive > 0 ? kActive : 1)];  // a row for each Gaussian
  const std::int64_t n = args.backward.gaussians.n_gaussians;
  const std::int64_t first_row = static_cast<std::int64_t>(blockIdx.x) * kThreads, i = first_row + threadIdx.x;
  const int n_rows = static_cast<int>(n - first_row < kThreads ? n - first_row : kThreads);
  if (i < n) step_gaussian<kShDegree>(args, i, rests + threadIdx.x * kActive);
  if constexpr (kActive > 0) {
    __syncthreads();  // all gradients are in shared memory, and nobody reads the harmonics any more
    step_rests<kActive>(args.adam[kRestGroup], first_row, n_rows, n_rest, rests);
  }
}

}  // namespace

void step_gaussians(const GaussianStepArgs& args, const LaunchContext& context) {
  const GaussianArrays& gaussians = args.backward.gaussians;
  if (gaussians.n_gaussians == 0) return;
  const auto blocks = static_cast<unsigned>((gaussians.n_gaussians + kThreads - 1) / kThreads);
  with_sh_degree(args.backward.sh_degree, [&](auto degree) {
    step_gaussians_kernel<degree.value>
        <<<blocks, kThreads, 0, context.stream>>>(args, rest_floats(gaussians.sh_degree_max));
  });
  B3DGS_CUDA_CHECK_LAUNCH();
}

}  // namespace b3dgs::cuda
