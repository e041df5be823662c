// Projection backward and Adam in one kernel: one thread per Gaussian computes its gradient and updates its parameters,
// except for the SH coefficients beyond degree 0, whose updates are deferred (deferred_sh.h).
//
// A step must read and write parameters and moments, 24 bytes per float; gradients in memory would add 8. Gaussians
// that the view does not see are updated too, since their moments decay.

#include "raster/cuda/launch.cuh"
#include "raster/cuda/project.cuh"
#include "train/optimizer/adam_step.cuh"
#include "train/optimizer/gaussian_step_cuda.h"

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

template <int kShDegree, bool kAntialiasing, bool kRegularized>
__global__ void __launch_bounds__(kThreads) step_gaussians_kernel(const __grid_constant__ GaussianStepArgs args) {
  const std::int64_t i = static_cast<std::int64_t>(blockIdx.x) * kThreads + threadIdx.x;
  if (i >= args.backward.gaussians.n_gaussians) return;
  GaussianGrad grad{};
  if (args.backward.radii[i] > 0) {
    grad = gaussian_grad<kShDegree, kAntialiasing>(args.backward, i);
    if (rest_floats(kShDegree) > 0) {
      float4* const update = reinterpret_cast<float4*>(args.updates + i);
      update[0] = make_float4(grad.color.x, grad.color.y, grad.color.z, __int_as_float(args.n_deferred));
      update[1] = make_float4(grad.dir.x, grad.dir.y, grad.dir.z, 0);
    }
    if (kRegularized) {
      const GaussianArrays& g = args.backward.gaussians;
      add_regularization(args.regularization, g.logit_opacities[i], load3(g.log_scales, i), grad.logit_opacity,
                         grad.log_scales);
    }
  }
  const Vec3f sh0 = grad.sh0();
  reinterpret_cast<float2*>(args.backward.grad.means2d)[i] = make_float2(grad.mean2d.x, grad.mean2d.y);
  step_row<3>(args.adam[0], i, {grad.mean.x, grad.mean.y, grad.mean.z});
  step_row<3>(args.adam[1], i, {grad.log_scales.x, grad.log_scales.y, grad.log_scales.z});
  step_four(args.adam[2], i, grad.quat);
  step_row<1>(args.adam[3], i, {grad.logit_opacity});
  step_row<3>(args.adam[4], i, {sh0.x, sh0.y, sh0.z});
}

}  // namespace

void step_gaussians(const GaussianStepArgs& args, const LaunchContext& context) {
  const std::int64_t n = args.backward.gaussians.n_gaussians;
  if (n == 0) return;
  const auto blocks = static_cast<unsigned>((n + kThreads - 1) / kThreads);
  with_sh_degree(args.backward.sh_degree, [&](auto degree) {
    const auto launch = [&](auto kernel) { kernel<<<blocks, kThreads, 0, context.stream>>>(args); };
    if (args.regularization.is_zero()) {
      launch(args.backward.antialiasing ? step_gaussians_kernel<degree.value, true, false>
                                        : step_gaussians_kernel<degree.value, false, false>);
    } else {
      launch(args.backward.antialiasing ? step_gaussians_kernel<degree.value, true, true>
                                        : step_gaussians_kernel<degree.value, false, true>);
    }
  });
  B3DGS_CUDA_CHECK_LAUNCH();
}

}  // namespace b3dgs::cuda
