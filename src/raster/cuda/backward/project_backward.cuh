// One Gaussian's gradient from its splat's sums: for the kernel that stores gradients, and for training's, which goes
// on with them.
#pragma once

#include "raster/cuda/passes.h"
#include "raster/math/projection.h"
#include "raster/math/array_rows.h"
#include "raster/math/sh.h"

namespace b3dgs::cuda {

/// By the stored parameters, and by the splat's centre in px; zeros for what no view sees. That by a coefficient of the
/// harmonics is the product of its basis function, at `dir`, and the gradient by the colour.
struct GaussianGrad {
  Vec3f mean, log_scales;
  Vec4f quat;
  float logit_opacity;
  Vec2f mean2d;
  Vec3f color;  // before it is clamped
  Vec3f dir;    // in which the Gaussian is seen
  B3DGS_HD Vec3f sh0() const { return static_cast<float>(kSh0) * color; }
};

/// Gradients of Gaussian i, which the view sees. kShDegree is that of `args`.
template <int kShDegree>
__device__ __forceinline__ GaussianGrad gaussian_grad(const ProjectBackwardCudaArgs& args, std::int64_t i) {
  const GaussianArrays& g = args.gaussians;
  const std::int32_t rank = args.rank_of_gaussian[i];
  const SplatGrad sum = args.splat_grads[rank].sum;
  const unsigned clamped = args.splats[rank].clamped;

  const ViewTransform<float> view = make_view_transform<float>(args.view);
  const Vec3f mean = load3(g.means, i);
  const Vec3f point = to_camera(view, mean);
  const Shape<float> shape = make_shape(load3(g.log_scales, i), load4(g.quats, i));
  const Projection<float> p = project_gaussian(view, point, shape.factor);
  const ProjectionGrad<float> grad = b3dgs::project_backward(view, point, shape.factor, p, Vec2f{sum.q_x, sum.q_y},
                                                             Sym2f{sum.q_xx, sum.q_xy, sum.q_yy}, sum.depth);
  const ShapeGrad<float> grad_shape = shape_backward(shape, grad.factor);
  const Vec3f grad_color{clamped & 1u ? 0.0f : sum.red, clamped & 2u ? 0.0f : sum.green,
                         clamped & 4u ? 0.0f : sum.blue};
  const ShOffsetGrad<float> grad_sh =
      sh_offset_grad(kShDegree, mean - args.view.center, g.shN + rest_floats(g.sh_degree_max) * i, grad_color);
  // q is the gradient by ln(opacity), and d ln(sigmoid(x)) / dx = sigmoid(-x).
  return {transpose_times(view.rotation, grad.point) + grad_sh.offset,
          grad_shape.log_scales,
          grad_shape.quat,
          sum.q / (1 + __expf(g.logit_opacities[i])),
          grad.mean2d,
          grad_color,
          grad_sh.dir};
}

}  // namespace b3dgs::cuda
