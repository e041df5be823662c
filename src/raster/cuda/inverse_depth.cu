// Inverse depth (math/inverse_depth.h): a thread per splat.

#include "raster/cuda/passes.h"
#include "raster/math/inverse_depth.h"

namespace b3dgs::cuda {
namespace {

constexpr int kThreads = 256;

__global__ void __launch_bounds__(kThreads) invert_depths_kernel(Splat* splats, std::int64_t n_splats) {
  const std::int64_t m = static_cast<std::int64_t>(blockIdx.x) * kThreads + threadIdx.x;
  if (m < n_splats) invert_depth(splats[m]);
}

__global__ void __launch_bounds__(kThreads)
    invert_depth_gradients_kernel(const Splat* splats, std::int64_t n_splats, SplatGradSum* splat_grads) {
  const std::int64_t m = static_cast<std::int64_t>(blockIdx.x) * kThreads + threadIdx.x;
  if (m < n_splats) splat_grads[m].sum.depth = depth_gradient(splats[m], splat_grads[m].sum.depth);
}

unsigned blocks_for(std::int64_t n_splats) {
  return static_cast<unsigned>((n_splats + kThreads - 1) / kThreads);
}

}  // namespace

void invert_depths(Splat* splats, std::int64_t n_splats, const LaunchContext& context) {
  if (n_splats == 0) return;
  invert_depths_kernel<<<blocks_for(n_splats), kThreads, 0, context.stream>>>(splats, n_splats);
  B3DGS_CUDA_CHECK_LAUNCH();
}

void invert_depth_gradients(const Splat* splats, std::int64_t n_splats, SplatGradSum* splat_grads,
                            const LaunchContext& context) {
  if (n_splats == 0) return;
  invert_depth_gradients_kernel<<<blocks_for(n_splats), kThreads, 0, context.stream>>>(splats, n_splats, splat_grads);
  B3DGS_CUDA_CHECK_LAUNCH();
}

}  // namespace b3dgs::cuda
