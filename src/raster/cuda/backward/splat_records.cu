// Keeps the sums of a view's splats for a later backward projection. A thread per Gaussian; no shared memory, no
// barriers.

#include "raster/cuda/passes.h"
#include "raster/math/projection.h"

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
    centre = centre_gradient(Vec2f{sum.q_x, sum.q_y});
  }
  args.out.record_of_gaussian[i] = record;
  reinterpret_cast<float2*>(args.out.means2d)[i] = make_float2(centre.x, centre.y);
}

}  // namespace

void keep_splat_records(const SplatRecordArgs& args, const LaunchContext& context) {
  if (args.n_gaussians == 0) return;
  const auto blocks = static_cast<unsigned>((args.n_gaussians + kThreads - 1) / kThreads);
  keep_splat_records_kernel<<<blocks, kThreads, 0, context.stream>>>(args);
  B3DGS_CUDA_CHECK_LAUNCH();
}

}  // namespace b3dgs::cuda
