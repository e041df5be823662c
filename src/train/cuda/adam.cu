// Adam on the GPU: one launch for all parameter groups. Each block works on 1024 floats of one group, 16 bytes a
// thread.

#include "raster/cuda/cuda_check.h"
#include "train/cuda/adam_cuda.h"

namespace b3dgs::cuda {
namespace {

constexpr int kThreads = 256;
constexpr int kPerBlock = 4 * kThreads;

struct AdamLaunch {
  AdamArgs groups[kAdamGroupCount];
  std::int64_t first_block[kAdamGroupCount + 1];
};

__device__ __forceinline__ void step_one(const AdamArgs& args, float grad, float& param, float& m, float& v) {
  constexpr auto kBeta1 = static_cast<float>(kAdamBeta1), kBeta2 = static_cast<float>(kAdamBeta2);
  m = kBeta1 * m + (1 - kBeta1) * grad;
  v = kBeta2 * v + (1 - kBeta2) * grad * grad;
  param -= args.step_size * m / (sqrtf(v) * args.inverse_root_bias2 + static_cast<float>(kAdamEpsilon));
}

__global__ void __launch_bounds__(kThreads) adam_kernel(const AdamLaunch launch) {
  int group = 0;
  while (static_cast<std::int64_t>(blockIdx.x) >= launch.first_block[group + 1]) ++group;
  const AdamArgs& args = launch.groups[group];
  const std::int64_t i =
      (static_cast<std::int64_t>(blockIdx.x) - launch.first_block[group]) * kPerBlock + 4 * threadIdx.x;
  if (i + 4 <= args.n) {
    const float4 grad = *reinterpret_cast<const float4*>(args.grad + i);
    float4 param = *reinterpret_cast<float4*>(args.param + i);
    float4 m = *reinterpret_cast<float4*>(args.m + i), v = *reinterpret_cast<float4*>(args.v + i);
    step_one(args, grad.x, param.x, m.x, v.x);
    step_one(args, grad.y, param.y, m.y, v.y);
    step_one(args, grad.z, param.z, m.z, v.z);
    step_one(args, grad.w, param.w, m.w, v.w);
    *reinterpret_cast<float4*>(args.param + i) = param;
    *reinterpret_cast<float4*>(args.m + i) = m;
    *reinterpret_cast<float4*>(args.v + i) = v;
    return;
  }
  for (std::int64_t k = i; k < args.n; ++k) step_one(args, args.grad[k], args.param[k], args.m[k], args.v[k]);
}

}  // namespace

void adam_step(const AdamGroups& groups, cudaStream_t stream) {
  AdamLaunch launch{};
  for (std::size_t group = 0; group < groups.size(); ++group) {
    launch.groups[group] = groups[group];
    launch.first_block[group + 1] = launch.first_block[group] + (groups[group].n + kPerBlock - 1) / kPerBlock;
  }
  const std::int64_t blocks = launch.first_block[kAdamGroupCount];
  if (blocks == 0) return;
  adam_kernel<<<static_cast<unsigned>(blocks), kThreads, 0, stream>>>(launch);
  B3DGS_CUDA_CHECK_LAUNCH();
}

}  // namespace b3dgs::cuda
