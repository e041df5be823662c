// Backward projection: turns the sums of a splat into the gradient of its Gaussian's stored parameters.
//   Grid: a thread per Gaussian. Gaussians that are not visible get zeros.
//   Shared memory: the SH gradients of the block above degree 0, up to 45 floats per Gaussian. The block then writes
//     them to global memory contiguously.
//   Barriers: one, before these writes.
// Training uses a fused kernel instead, which applies the optimizer step without storing gradients.

#include "raster/cuda/launch.cuh"
#include "raster/cuda/project.cuh"

namespace b3dgs::cuda {
namespace {

constexpr int kThreads = 128;

template <int kShDegree, bool kAntialiasing, class Lens>
__global__ void __launch_bounds__(kThreads) project_backward_kernel(const ProjectBackwardCudaArgs args, int n_rest) {
  extern __shared__ float rests[];  // [kThreads, n_rest]
  const std::int64_t n = args.gaussians.n_gaussians;
  const std::int64_t block_first = static_cast<std::int64_t>(blockIdx.x) * kThreads;
  const std::int64_t i = block_first + threadIdx.x;
  float* const rest = rests + threadIdx.x * n_rest;
  for (int k = 0; k < n_rest; ++k) rest[k] = 0;
  if (i < n) {
    GaussianGrad grad{};
    if (args.radii[i] > 0) {
      grad = gaussian_grad<kShDegree, kAntialiasing, Lens>(args, i);
      sh_rest_grad(kShDegree, grad.dir, grad.color, rest);
    }
    store3(args.grad.means, i, grad.mean);
    store3(args.grad.log_scales, i, grad.log_scales);
    store4(args.grad.quats, i, grad.quat);
    args.grad.logit_opacities[i] = grad.logit_opacity;
    store3(args.grad.sh0, i, grad.sh0());
    reinterpret_cast<float2*>(args.grad.means2d)[i] = make_float2(grad.mean2d.x, grad.mean2d.y);
  }
  __syncthreads();  // SH gradients of the block are complete
  const std::int64_t rows = n - block_first < kThreads ? n - block_first : kThreads;
  float* const out = args.grad.shN + block_first * n_rest;
  for (int k = static_cast<int>(threadIdx.x); k < rows * n_rest; k += kThreads) out[k] = rests[k];
}

}  // namespace

void project_backward(const ProjectBackwardCudaArgs& args, const LaunchContext& context) {
  const int n_rest = rest_floats(args.gaussians.sh_degree_max);
  static_assert(sizeof(float) * kThreads * rest_floats(kShDegreeMax) <= 48 * 1024,
                "fits into the shared memory that a block gets without opt-in");
  const auto blocks = static_cast<unsigned>(n_blocks(args.gaussians.n_gaussians, kThreads));
  if (blocks == 0) return;
  const std::size_t shared_bytes = sizeof(float) * kThreads * static_cast<std::size_t>(n_rest);
  with_constants(args.sh_degree, args.antialiasing, args.view.lens, [&](auto degree, auto antialiasing, auto lens) {
    const auto kernel = project_backward_kernel<degree.value, antialiasing.value, decltype(lens)>;
    kernel<<<blocks, kThreads, shared_bytes, context.stream>>>(args, n_rest);
  });
  B3DGS_CUDA_CHECK_LAUNCH();
}

}  // namespace b3dgs::cuda
