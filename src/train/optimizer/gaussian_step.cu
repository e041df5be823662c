// Backward projection and Adam in one kernel. One thread per Gaussian computes its gradient and updates its parameters,
// except for the SH coefficients beyond degree 0, whose updates are deferred (deferred_sh.h).
//
// A step must read and write parameters and moments, which takes 24 bytes per float. Gradients in memory would add 8.
// The gradients of means, scales and colours go through shared memory, so that a warp writes whole memory sectors. A
// single barrier separates reading the parameters from writing them.

#include "train/optimizer/gaussian_step.h"

#include "core/cuda_rows.cuh"
#include "raster/cuda/launch.cuh"
#include "raster/cuda/project.cuh"
#include "train/optimizer/adam_step.cuh"

namespace b3dgs::cuda {
namespace {

constexpr int kThreads = 128;

__device__ __forceinline__ void step_four(const AdamArgs& args, std::int64_t row, Vec4f grad) {
  float4& param_at = reinterpret_cast<float4*>(args.param)[row];
  float4& m_at = reinterpret_cast<float4*>(args.m)[row];
  float4& v_at = reinterpret_cast<float4*>(args.v)[row];
  float4 param = param_at, m = m_at, v = v_at;
  step_one(args.size, grad.x, param.x, m.x, v.x);
  step_one(args.size, grad.y, param.y, m.y, v.y);
  step_one(args.size, grad.z, param.z, m.z, v.z);
  step_one(args.size, grad.w, param.w, m.w, v.w);
  param_at = param;
  m_at = m;
  v_at = v;
}

/// Steps the block's rows of three floats along `grads`, one float per thread at a time.
__device__ __forceinline__ void step_threes(const AdamArgs& args, std::int64_t first_row, std::int64_t n_gaussians,
                                            const float* grads) {
  float param[3], m[3], v[3];
#pragma unroll
  for (int j = 0; j < 3; ++j) {
    const std::int64_t at = 3 * first_row + j * kThreads + threadIdx.x;
    if (at >= 3 * n_gaussians) break;
    param[j] = args.param[at];
    m[j] = args.m[at];
    v[j] = args.v[at];
  }
#pragma unroll
  for (int j = 0; j < 3; ++j) {
    const std::int64_t at = 3 * first_row + j * kThreads + threadIdx.x;
    if (at >= 3 * n_gaussians) break;
    step_one(args.size, grads[j * kThreads + threadIdx.x], param[j], m[j], v[j]);
    args.param[at] = param[j];
    args.m[at] = m[j];
    args.v[at] = v[j];
  }
}

template <int kShDegree, bool kAntialiasing, bool kRegularized, class Lens>
__global__ void __launch_bounds__(kThreads) step_gaussians_kernel(const __grid_constant__ GaussianStepArgs args) {
  __shared__ float mean_grads[3 * kThreads], scale_grads[3 * kThreads], sh0_grads[3 * kThreads];
  const std::int64_t first_row = static_cast<std::int64_t>(blockIdx.x) * kThreads, i = first_row + threadIdx.x;
  const std::int64_t n = args.backward.gaussians.n_gaussians;
  GaussianGrad grad{};
  if (i < n && args.backward.radii[i] > 0) {
    grad = gaussian_grad<kShDegree, kAntialiasing, Lens>(args.backward, i);
    SeenDirections seen;
    seen.add(grad.dir, grad.color);
    const float decay = sh_decay(args.sh_decay, i, seen);
    if (rest_floats(kShDegree) > 0) {
      float4* const update = reinterpret_cast<float4*>(args.updates + i);
      update[0] = make_float4(grad.color.x, grad.color.y, grad.color.z, __int_as_float(args.n_deferred));
      update[1] = make_float4(grad.dir.x, grad.dir.y, grad.dir.z, decay);
    }
    if (kRegularized) {
      const GaussianArrays& g = args.backward.gaussians;
      add_regularization(args.regularization, g.logit_opacities[i], load3(g.log_scales, i), grad.logit_opacity,
                         grad.log_scales);
    }
  }
  store3(mean_grads, threadIdx.x, grad.mean);
  store3(scale_grads, threadIdx.x, grad.log_scales);
  store3(sh0_grads, threadIdx.x, grad.sh0());
  __syncthreads();  // gradients are complete, and parameters have been read
  if (i < n) {
    reinterpret_cast<float2*>(args.backward.grad.means2d)[i] = make_float2(grad.mean2d.x, grad.mean2d.y);
    step_four(args.adam[kQuatGroup], i, grad.quat);
    step_row<1>(args.adam[kOpacityGroup], i, {grad.logit_opacity});
  }
  step_threes(args.adam[kMeanGroup], first_row, n, mean_grads);
  step_threes(args.adam[kScaleGroup], first_row, n, scale_grads);
  step_threes(args.adam[kSh0Group], first_row, n, sh0_grads);
}

// The same for steps of several views (--batch). The SH coefficients beyond degree 0 of the Gaussians that are visible
// in any view are stepped by the whole block, coalesced. Shared memory contains their gradients, up to 45 floats per
// Gaussian. A single barrier separates these gradients from the step, because the gradients of the means depend on the
// coefficients.

/// Shrinks the SH coefficients beyond degree 0 of the block's visible rows by `decays` and steps them along `rests`
/// (sums over the views). Each thread reads several coefficients before it steps any, because otherwise it would mostly
/// wait for memory.
template <int kActive>
__device__ __forceinline__ void step_rests(const BatchStepArgs& args, std::int64_t first_row, float scale,
                                           const float* rests, const bool* is_seen, const float* decays) {
  constexpr int kTogether = kActive % 9 == 0 ? 9 : 8;
  static_assert(kActive % kTogether == 0, "each thread steps kActive coefficients");
  const AdamArgs& adam = args.adam[kShGroup];
  const int n_rest = rest_floats(args.grad.gaussians.sh_degree_max);
  for (int first = 0; first < kActive; first += kTogether) {
    std::int64_t at[kTogether];
    float param[kTogether], m[kTogether], v[kTogether];
#pragma unroll
    for (int j = 0; j < kTogether; ++j) {
      const int k = (first + j) * kThreads + static_cast<int>(threadIdx.x), row = k / kActive;
      at[j] = is_seen[row] ? (first_row + row) * n_rest + (k - row * kActive) : -1;
      if (at[j] < 0) continue;
      param[j] = adam.param[at[j]];
      m[j] = adam.m[at[j]];
      v[j] = adam.v[at[j]];
    }
#pragma unroll
    for (int j = 0; j < kTogether; ++j) {
      if (at[j] < 0) continue;
      const int k = (first + j) * kThreads + static_cast<int>(threadIdx.x), row = k / kActive;
      param[j] = decayed(param[j], adam.size.step_size * decays[row], (k - row * kActive) / 3);
      step_one(adam.size, scale * rests[k], param[j], m[j], v[j], args.rule);
      adam.param[at[j]] = param[j];
      adam.m[at[j]] = m[j];
      adam.v[at[j]] = v[j];
    }
  }
}

template <int kShDegree, bool kAntialiasing, class Lens>
__global__ void __launch_bounds__(kThreads) step_batch_kernel(const __grid_constant__ BatchStepArgs args) {
  constexpr int kActive = rest_floats(kShDegree);
  __shared__ float rests[kThreads * kActive + 1];
  __shared__ bool is_seen[kThreads];
  __shared__ float decays[kThreads];
  const std::int64_t first_row = static_cast<std::int64_t>(blockIdx.x) * kThreads, i = first_row + threadIdx.x;
  const float scale = 1.0f / static_cast<float>(args.grad.n_views);
  float* const own_rest = rests + threadIdx.x * kActive;
  for (int k = 0; k < kActive; ++k) own_rest[k] = 0;
  is_seen[threadIdx.x] = false;
  if (i < args.grad.gaussians.n_gaussians) {
    const BatchGrad grad = batch_grad<kAntialiasing, Lens>(args.grad, i, kShDegree, scale, own_rest);
    is_seen[threadIdx.x] = grad.is_seen;
    decays[threadIdx.x] = sh_decay(args.sh_decay, i, grad.seen_from);
    if (kActive > 0 && grad.is_seen) {
      reinterpret_cast<float4*>(args.updates + i)[0] = make_float4(0, 0, 0, __int_as_float(args.n_deferred + 1));
    }
    step_row<3>(args.adam[kMeanGroup], i, {grad.mean.x, grad.mean.y, grad.mean.z}, args.rule);
    step_row<3>(args.adam[kScaleGroup], i, {grad.log_scales.x, grad.log_scales.y, grad.log_scales.z}, args.rule);
    step_row<4>(args.adam[kQuatGroup], i, {grad.quat.x, grad.quat.y, grad.quat.z, grad.quat.w}, args.rule);
    step_row<1>(args.adam[kOpacityGroup], i, {grad.logit_opacity}, args.rule);
    step_row<3>(args.adam[kSh0Group], i, {grad.sh0.x, grad.sh0.y, grad.sh0.z}, args.rule);
  }
  if constexpr (kActive > 0) {
    __syncthreads();  // gradients of the block are complete, and the coefficients have been read
    step_rests<kActive>(args, first_row, scale, rests, is_seen, decays);
  }
}

}  // namespace

void step_gaussians(const GaussianStepArgs& args, const LaunchContext& context) {
  with_sh_degree(args.backward.sh_degree, [&](auto degree) {
    constexpr int kDegree = degree.value;
    with_lens(args.backward.view.lens, [&](const auto& lens) {
      using Lens = std::decay_t<decltype(lens)>;
      auto* kernel = args.backward.antialiasing ? step_gaussians_kernel<kDegree, true, true, Lens>
                                                : step_gaussians_kernel<kDegree, false, true, Lens>;
      if (args.regularization.is_zero()) {
        kernel = args.backward.antialiasing ? step_gaussians_kernel<kDegree, true, false, Lens>
                                            : step_gaussians_kernel<kDegree, false, false, Lens>;
      }
      launch_rows<kThreads>(kernel, args, args.backward.gaussians.n_gaussians, context.stream);
    });
  });
}

void step_batch(const BatchStepArgs& args, const LaunchContext& context) {
  with_sh_degree(args.grad.sh_degree, [&](auto degree) {
    constexpr int kDegree = degree.value;
    const bool pinholes = args.grad.lenses == nullptr;
    const auto kernel =
        args.grad.antialiasing
            ? (pinholes ? step_batch_kernel<kDegree, true, Pinhole> : step_batch_kernel<kDegree, true, ViewLens>)
            : (pinholes ? step_batch_kernel<kDegree, false, Pinhole> : step_batch_kernel<kDegree, false, ViewLens>);
    launch_rows<kThreads>(kernel, args, args.grad.gaussians.n_gaussians, context.stream);
  });
}

}  // namespace b3dgs::cuda
