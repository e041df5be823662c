// The gradient of one Gaussian in a step of several views (--batch). It is the sum, in the order of the views, of the
// backward projections of its kept splats, regardless of where these were rendered.
#pragma once

#include <cstdint>
#include <type_traits>

#include "config/batch_steps.h"
#include "raster/math/gaussian_grad.h"
#include "train/optimizer/adam_args.h"
#include "train/optimizer/sh_decay.h"

namespace b3dgs {

/// One view of a step, rendered with N Gaussians into M splats.
struct BatchView {
  PinholeView view{};
  const SplatRecord* records = nullptr;              // [M]
  const std::int32_t* record_of_gaussian = nullptr;  // [N] index into records, -1 if not visible
  RegularizationGrad regularization{};
};

/// Arguments of batch_grad(). The views are stored inside the struct, so that it can be a kernel argument.
struct BatchGradArgs {
  GaussianArrays gaussians{};
  int sh_degree = 0;  // that the views were rendered with
  bool antialiasing = false;
  std::int32_t n_views = 0;
  const ViewLens* lenses = nullptr;  // [n_views], or null if all are pinholes
  BatchView views[kMaxBatch]{};
};

/// Sum of GaussianGrad over the views, without SH coefficients beyond degree 0.
struct BatchGrad {
  bool is_seen = false;  // in any view
  Vec3f mean{}, log_scales{}, sh0{};
  Vec4f quat{};
  float logit_opacity = 0;
  SeenDirections seen_from{};
};

/// Adds the gradients with respect to the SH coefficients above degree 0 to `sums`, given the gradient with respect to
/// the colour seen along the unit vector `dir`.
B3DGS_HD void add_sh_rest_grad(int degree, const Vec3f& dir, const Vec3f& grad_color, float* sums) {
  float basis[16]{};
  sh_basis(degree, dir, basis);
  const int n = (degree + 1) * (degree + 1);
  for (int k = 1; k < n; ++k) {
    sums[3 * (k - 1)] += basis[k] * grad_color.x;
    sums[3 * (k - 1) + 1] += basis[k] * grad_color.y;
    sums[3 * (k - 1) + 2] += basis[k] * grad_color.z;
  }
}

/// Returns the gradient of Gaussian i, multiplied by `scale`. With 1 / n_views, this is the gradient of the mean.
/// `rest` [rest_floats(sh_degree)] must be 0 and receives the *sum* of the gradients with respect to the SH
/// coefficients above degree 0, which is not multiplied. `sh_degree` must equal args.sh_degree, and kAntialiasing
/// args.antialiasing. Lens is ViewLens, or Pinhole if all views are pinholes.
template <bool kAntialiasing, class Lens>
B3DGS_HD BatchGrad batch_grad(const BatchGradArgs& args, std::int64_t i, int sh_degree, float scale, float* rest) {
  BatchGrad sum;
  for (std::int32_t v = 0; v < args.n_views; ++v) {
    const BatchView& view = args.views[v];
    const std::int32_t index = view.record_of_gaussian[i];
    if (index < 0) continue;
    const SplatRecord record = view.records[index];
    const auto through = [&](const auto& lens) {
      return gaussian_grad<kAntialiasing>(args.gaussians, i, make_view_transform<float>(view.view), lens,
                                          view.view.center, sh_degree, record.sum, record.clamped);
    };
    GaussianGrad grad;
    if constexpr (std::is_same_v<Lens, Pinhole>) {
      grad = through(Pinhole{});
    } else {
      grad = args.lenses[v].kind == LensKind::kPinhole ? through(Pinhole{}) : through(args.lenses[v]);
    }
    if (!view.regularization.is_zero()) {
      add_regularization(view.regularization, args.gaussians.logit_opacities[i], load3(args.gaussians.log_scales, i),
                         grad.logit_opacity, grad.log_scales);
    }
    sum.is_seen = true;
    sum.seen_from.add(grad.dir, grad.color);
    sum.mean = sum.mean + grad.mean;
    sum.log_scales = sum.log_scales + grad.log_scales;
    sum.quat = {sum.quat.x + grad.quat.x, sum.quat.y + grad.quat.y, sum.quat.z + grad.quat.z, sum.quat.w + grad.quat.w};
    sum.logit_opacity += grad.logit_opacity;
    sum.sh0 = sum.sh0 + grad.sh0();
    if (sh_degree > 0) add_sh_rest_grad(sh_degree, grad.dir, grad.color, rest);
  }
  sum.mean = scale * sum.mean;
  sum.log_scales = scale * sum.log_scales;
  sum.quat = {scale * sum.quat.x, scale * sum.quat.y, scale * sum.quat.z, scale * sum.quat.w};
  sum.logit_opacity *= scale;
  sum.sh0 = scale * sum.sh0;
  return sum;
}

}  // namespace b3dgs
