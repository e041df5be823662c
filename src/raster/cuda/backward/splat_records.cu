// Keeps the sums of a view's splats for a later backward projection. A thread per Gaussian, or per splat if the splats
// were drawn elsewhere; rows of Gaussians that the view does not see are then written before. No shared memory, no
// barriers.

#include "raster/cuda/passes.h"
#include "raster/math/gaussian_grad.h"

namespace b3dgs::cuda {
namespace {

constexpr int kThreads = 256;

__global__ void __launch_bounds__(kThreads) keep_splat_records_kernel(const SplatRecordArgs args) {
  const std::int64_t i = static_cast<std::int64_t>(blockIdx.x) * kThreads + threadIdx.x;
  if (i >= args.n_gaussians) return;
  std::int32_t record = -1;
  Vec2f centre{0, 0};
  if (args.radii[i] > 0) {
    record = args.rank_of_gaussian[i];
    const SplatGrad sum = args.splat_grads[record].sum;
    args.out.records[record] = {sum, static_cast<std::int32_t>(i), args.splats[record].clamped};
    centre = centre_gradient(Vec2f{sum.mean_x, sum.mean_y});
  }
  args.out.record_of_gaussian[i] = record;
  reinterpret_cast<float2*>(args.out.means2d)[i] = make_float2(centre.x, centre.y);
}

__global__ void __launch_bounds__(kThreads) keep_splats_kernel(const KeepSplatsArgs args) {
  const std::int64_t m = static_cast<std::int64_t>(blockIdx.x) * kThreads + threadIdx.x;
  if (m < args.rows.n_splats) keep_splat(args, m);
}

}  // namespace

void keep_splat_records(const SplatRecordArgs& args, const LaunchContext& context) {
  if (args.n_gaussians == 0) return;
  const auto blocks = static_cast<unsigned>((args.n_gaussians + kThreads - 1) / kThreads);
  keep_splat_records_kernel<<<blocks, kThreads, 0, context.stream>>>(args);
  B3DGS_CUDA_CHECK_LAUNCH();
}

void keep_splats(const KeepSplatsArgs& args, const LaunchContext& context) {
  if (args.n_gaussians == 0) return;
  const auto fill = [&](void* rows, int value, std::size_t row_bytes) {
    const std::size_t bytes = static_cast<std::size_t>(args.n_gaussians) * row_bytes;
    B3DGS_CUDA_CHECK(cudaMemsetAsync(rows, value, bytes, context.stream));
  };
  fill(args.out.record_of_gaussian, 0xff, sizeof(std::int32_t));  // -1
  fill(args.out.means2d, 0, 2 * sizeof(float));
  fill(args.radii, 0, sizeof(std::int32_t));
  if (args.rows.n_splats == 0) return;
  const auto blocks = static_cast<unsigned>((args.rows.n_splats + kThreads - 1) / kThreads);
  keep_splats_kernel<<<blocks, kThreads, 0, context.stream>>>(args);
  B3DGS_CUDA_CHECK_LAUNCH();
}

}  // namespace b3dgs::cuda
