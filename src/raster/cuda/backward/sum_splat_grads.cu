// Deterministic gradients: sums the gradients of each splat's pairs in a fixed order. A warp per splat; lanes take the
// pairs in turn, and the lanes are summed with shuffles. No shared memory, no barriers.

#include "raster/cuda/passes.h"
#include "raster/cuda/warp.cuh"

namespace b3dgs::cuda {
namespace {

constexpr int kThreads = 256;

__device__ __forceinline__ void add(float4& sum, float4 value) {
  sum = make_float4(sum.x + value.x, sum.y + value.y, sum.z + value.z, sum.w + value.w);
}

__global__ void __launch_bounds__(kThreads) sum_splat_grads_kernel(const SumSplatGradsArgs args) {
  constexpr int kWords = sizeof(SplatGradSum) / sizeof(float4);
  const std::int64_t splat = (static_cast<std::int64_t>(blockIdx.x) * kThreads + threadIdx.x) / kWarpSize;
  if (splat >= args.n_splats) return;
  float4 sum[kWords]{};
  for (std::int64_t slot = args.slot_offsets[splat] + lane_id(); slot < args.slot_offsets[splat + 1];
       slot += kWarpSize) {
    const auto* const words = reinterpret_cast<const float4*>(args.pair_grads + slot);
    for (int k = 0; k < kWords; ++k) add(sum[k], words[k]);
  }
  auto* const out = reinterpret_cast<float4*>(args.splat_grads + splat);
#pragma unroll
  for (int k = 0; k < kWords; ++k) {
    const float4 whole = make_float4(warp_sum(sum[k].x), warp_sum(sum[k].y), warp_sum(sum[k].z), warp_sum(sum[k].w));
    if (lane_id() == 0) out[k] = whole;
  }
}

}  // namespace

void sum_splat_grads(const SumSplatGradsArgs& args, const LaunchContext& context) {
  if (args.n_splats == 0) return;
  const auto blocks = static_cast<unsigned>((args.n_splats * kWarpSize + kThreads - 1) / kThreads);
  sum_splat_grads_kernel<<<blocks, kThreads, 0, context.stream>>>(args);
  B3DGS_CUDA_CHECK_LAUNCH();
}

}  // namespace b3dgs::cuda
