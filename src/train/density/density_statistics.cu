// Adds one view to the density statistics, one thread per Gaussian.

#include "core/cuda_rows.cuh"
#include "train/density/density_statistics_cuda.h"

namespace b3dgs::cuda {
namespace {

constexpr int kThreads = 256;

__global__ void __launch_bounds__(kThreads) add_view_kernel(const AddViewArgs args) {
  const std::int64_t i = own_row<kThreads>();
  if (i >= args.n_gaussians || args.radii[i] <= 0) return;
  const float2 grad = reinterpret_cast<const float2*>(args.means2d_grad)[i];
  const float dx = grad.x * args.half_width, dy = grad.y * args.half_height;
  args.grad_norm_sum[i] += sqrtf(dx * dx + dy * dy);
  args.view_count[i] += 1;
  args.max_radii[i] = max(args.max_radii[i], args.radii[i]);
}

}  // namespace

void add_view(const AddViewArgs& args, cudaStream_t stream) {
  launch_rows<kThreads>(add_view_kernel, args, args.n_gaussians, stream);
}

}  // namespace b3dgs::cuda
