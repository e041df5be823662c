// Colours of the splats that a view sees.

#include "raster/cuda/color.cuh"
#include "raster/cuda/launch.cuh"

namespace b3dgs::cuda {
namespace {

constexpr int kThreads = 128;

template <int kShDegree>
__global__ void __launch_bounds__(kThreads) color_kernel(const ColorCudaArgs args) {
  constexpr int kActive = rest_floats(kShDegree);
  __shared__ RowList<kThreads> list;
  __shared__ float rests[kThreads * (kActive > 0 ? kActive : 1)];  // a row for each place in the list
  const std::int64_t first_row = static_cast<std::int64_t>(blockIdx.x) * kThreads, i = first_row + threadIdx.x;
  const bool is_seen = i < args.gaussians.n_gaussians && args.radii[i] > 0;
  const ListedRow own = list_row(list, is_seen);
  if constexpr (kActive > 0) {
    __syncthreads();  // the list is complete
    const int n_rest = rest_floats(args.gaussians.sh_degree_max);
    const float* const block_rests = args.gaussians.shN + first_row * n_rest;
#pragma unroll 4
    for (int k = static_cast<int>(threadIdx.x); k < own.n_rows * kActive; k += kThreads) {
      rests[k] = block_rests[list.rows[k / kActive] * n_rest + k % kActive];
    }
    __syncthreads();
  }
  if (is_seen) color_splat<kShDegree>(args, i, rests + own.place * kActive);
}

}  // namespace

void color_splats(const ColorCudaArgs& args, const LaunchContext& context) {
  const std::int64_t n = args.gaussians.n_gaussians;
  if (n == 0) return;
  const auto blocks = static_cast<unsigned>((n + kThreads - 1) / kThreads);
  with_sh_degree(args.sh_degree,
                 [&](auto degree) { color_kernel<degree.value><<<blocks, kThreads, 0, context.stream>>>(args); });
  B3DGS_CUDA_CHECK_LAUNCH();
}

}  // namespace b3dgs::cuda
