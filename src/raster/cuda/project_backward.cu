// Projection backward: one thread per Gaussian turns its splat's sums into gradients of the stored parameters.
// Harmonics' gradients, 45 floats a Gaussian, go through shared memory so that a block writes them side by side.

#include "raster/cuda/passes.h"
#include "raster/projection.h"
#include "raster/sh.h"

namespace b3dgs::cuda {
namespace {

constexpr int kThreads = 128;
constexpr int kRestMax = 3 * ((kShDegreeMax + 1) * (kShDegreeMax + 1) - 1);

__device__ __forceinline__ Vec3f load3(const float* array, std::int64_t i) {
  return {array[3 * i], array[3 * i + 1], array[3 * i + 2]};
}
__device__ __forceinline__ void store3(float* array, std::int64_t i, Vec3f v) {
  array[3 * i] = v.x;
  array[3 * i + 1] = v.y;
  array[3 * i + 2] = v.z;
}

struct GaussianGrad {
  Vec3f mean, log_scales;
  Vec4f quat;
  float logit_opacity;
  Vec2f mean2d;
};

/// Gradients of Gaussian i, which the view sees; harmonics' gradients go to `sh0` [3] and `rest` (cleared before).
__device__ GaussianGrad backward_one(const ProjectBackwardCudaArgs& args, std::int64_t i, float* sh0, float* rest,
                                     int n_rest) {
  const GaussianArrays& g = args.gaussians;
  const std::int32_t rank = args.rank_of_gaussian[i];
  const SplatGrad sum = args.splat_grads[rank].sum;
  const unsigned clamped = args.splats[rank].clamped;

  const ViewTransform<float> view = make_view_transform<float>(args.view);
  const Vec3f mean = load3(g.means, i);
  const Vec3f point = to_camera(view, mean);
  const float4 quat = reinterpret_cast<const float4*>(g.quats)[i];
  const Shape<float> shape = make_shape(load3(g.log_scales, i), Vec4f{quat.x, quat.y, quat.z, quat.w});
  const Projection<float> p = project_gaussian(view, point, shape.factor);
  const ProjectionGrad<float> grad = b3dgs::project_backward(view, point, shape.factor, p, Vec2f{sum.q_x, sum.q_y},
                                                             Sym2f{sum.q_xx, sum.q_xy, sum.q_yy}, sum.depth);
  const ShapeGrad<float> grad_shape = shape_backward(shape, grad.factor);
  const Vec3f grad_color{clamped & 1u ? 0.0f : sum.red, clamped & 2u ? 0.0f : sum.green,
                         clamped & 4u ? 0.0f : sum.blue};
  const Vec3f grad_offset =
      sh_color_backward(args.sh_degree, mean - args.view.center, g.shN + n_rest * i, grad_color, sh0, rest);
  // q is the gradient by ln(opacity), and d ln(sigmoid(x)) / dx = sigmoid(-x).
  return {transpose_times(view.rotation, grad.point) + grad_offset, grad_shape.log_scales, grad_shape.quat,
          sum.q / (1 + __expf(g.logit_opacities[i])), grad.mean2d};
}

__global__ void __launch_bounds__(kThreads) project_backward_kernel(const ProjectBackwardCudaArgs args, int n_rest) {
  extern __shared__ float rests[];  // [kThreads, n_rest]
  const std::int64_t n = args.gaussians.n_gaussians;
  const std::int64_t block_first = static_cast<std::int64_t>(blockIdx.x) * kThreads;
  const std::int64_t i = block_first + threadIdx.x;
  float* const rest = rests + threadIdx.x * n_rest;
  for (int k = 0; k < n_rest; ++k) rest[k] = 0;
  if (i < n) {
    GaussianGrad grad{};
    float sh0[3] = {0, 0, 0};
    if (args.radii[i] > 0) grad = backward_one(args, i, sh0, rest, n_rest);
    store3(args.grad.means, i, grad.mean);
    store3(args.grad.log_scales, i, grad.log_scales);
    reinterpret_cast<float4*>(args.grad.quats)[i] = make_float4(grad.quat.x, grad.quat.y, grad.quat.z, grad.quat.w);
    args.grad.logit_opacities[i] = grad.logit_opacity;
    store3(args.grad.sh0, i, {sh0[0], sh0[1], sh0[2]});
    reinterpret_cast<float2*>(args.grad.means2d)[i] = make_float2(grad.mean2d.x, grad.mean2d.y);
  }
  __syncthreads();  // all rows are in shared memory
  const std::int64_t rows = n - block_first < kThreads ? n - block_first : kThreads;
  float* const out = args.grad.shN + block_first * n_rest;
  for (int k = static_cast<int>(threadIdx.x); k < rows * n_rest; k += kThreads) out[k] = rests[k];
}

}  // namespace

void project_backward(const ProjectBackwardCudaArgs& args, const LaunchContext& context) {
  const std::int64_t n = args.gaussians.n_gaussians;
  if (n == 0) return;
  const int degree = args.gaussians.sh_degree_max;
  const int n_rest = 3 * ((degree + 1) * (degree + 1) - 1);
  static_assert(sizeof(float) * kThreads * kRestMax <= 48 * 1024, "fits without asking for more shared memory");
  project_backward_kernel<<<static_cast<unsigned>((n + kThreads - 1) / kThreads), kThreads,
                            sizeof(float) * kThreads* static_cast<std::size_t>(n_rest), context.stream>>>(args, n_rest);
  B3DGS_CUDA_CHECK_LAUNCH();
}

}  // namespace b3dgs::cuda
