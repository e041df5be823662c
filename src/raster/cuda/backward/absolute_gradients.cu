// Absolute gradients with respect to the projected centres, from the splats' sums. A thread per splat; rows of
// Gaussians that the view does not see are zeroed before. No shared memory, no barriers.

#include "raster/cuda/passes.h"
#include "raster/math/projection.h"

namespace b3dgs::cuda {
namespace {

constexpr int kThreads = 256;

__global__ void __launch_bounds__(kThreads) absolute_gradients_kernel(const AbsoluteGradientArgs args) {
  const std::int64_t m = static_cast<std::int64_t>(blockIdx.x) * kThreads + threadIdx.x;
  if (m >= args.n_splats) return;
  const Vec2f gradient = centre_gradient(Vec2f{args.splat_grads[m].abs_x, args.splat_grads[m].abs_y});
  reinterpret_cast<float2*>(args.out)[args.splats[m].gaussian] = make_float2(gradient.x, gradient.y);
}

}  // namespace

void absolute_gradients(const AbsoluteGradientArgs& args, const LaunchContext& context) {
  const std::size_t bytes = static_cast<std::size_t>(args.n_gaussians) * 2 * sizeof(float);
  B3DGS_CUDA_CHECK(cudaMemsetAsync(args.out, 0, bytes, context.stream));
  if (args.n_splats == 0) return;
  const auto blocks = static_cast<unsigned>((args.n_splats + kThreads - 1) / kThreads);
  absolute_gradients_kernel<<<blocks, kThreads, 0, context.stream>>>(args);
  B3DGS_CUDA_CHECK_LAUNCH();
}

}  // namespace b3dgs::cuda
