// Regularisation of opacity and scale, which makes Gaussians that the image does not need transparent and small:
//   loss += opacity_reg mean(o) + scale_reg mean(s)
// The means are over the M Gaussians that the view sees (scales: 3 M numbers), so that the effect on one
// Gaussian does not depend on how many others are out of view. --scale_reg is for scales in units of a fifth of the
// scene extent; regularization_weights() converts it to world units. Kheradmand et al. 2024 average over all Gaussians.
// The same arithmetic on CPU and GPU.
#pragma once

#include <cmath>
#include <cstdint>

#include "core/vec.h"

namespace b3dgs {

/// Factors of the two means, for scales in world units (see regularization_weights()); 0 = off.
struct RegularizationWeights {
  double opacity = 0, scale = 0;
};

/// Gradients of these terms with respect to the opacity and to each scale of a Gaussian that the view sees.
struct RegularizationGrad {
  float opacity = 0, scale = 0;
  B3DGS_HD bool is_zero() const { return opacity == 0 && scale == 0; }
};

/// `n_seen`: M, the number of Gaussians that the view sees.
inline RegularizationGrad regularization_grad(const RegularizationWeights& weights, std::int64_t n_seen) {
  if (n_seen == 0) return {};
  const double n = static_cast<double>(n_seen);
  return {static_cast<float>(weights.opacity / n), static_cast<float>(weights.scale / (3 * n))};
}

/// Adds the gradients with respect to the stored parameters of a Gaussian that the view sees.
B3DGS_HD void add_regularization(const RegularizationGrad& grad, float logit_opacity, const Vec3f& log_scales,
                                 float& grad_logit_opacity, Vec3f& grad_log_scales) {
  using std::exp;
  using std::fabs;
  const float tail = exp(-fabs(logit_opacity));  // do / d(logit) = o (1 - o)
  grad_logit_opacity += grad.opacity * (tail / ((1 + tail) * (1 + tail)));
  grad_log_scales.x += grad.scale * exp(log_scales.x);  // ds / d(ln s) = s
  grad_log_scales.y += grad.scale * exp(log_scales.y);
  grad_log_scales.z += grad.scale * exp(log_scales.z);
}

}  // namespace b3dgs
