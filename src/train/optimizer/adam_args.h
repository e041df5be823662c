// Arguments of one Adam step over one array, without torch.
#pragma once

#include <array>
#include <cmath>
#include <cstdint>

#include "core/vec.h"

namespace b3dgs {

inline constexpr double kAdamBeta1 = 0.9;
inline constexpr double kAdamBeta2 = 0.999;
// As in the original 3DGS, because gradients of a mean over all pixels are tiny.
inline constexpr double kAdamEpsilon = 1e-15;

/// Coefficients that depend on the number of views of a step (--batch). The default is one view.
struct AdamRule {
  float beta1 = static_cast<float>(kAdamBeta1), rest1 = static_cast<float>(1 - kAdamBeta1);
  float beta2 = static_cast<float>(kAdamBeta2), rest2 = static_cast<float>(1 - kAdamBeta2);
  float epsilon = static_cast<float>(kAdamEpsilon);
};

/// Returns the coefficients for the gradient of a mean over n views, where learning rates are multiplied by sqrt(n).
/// The moments then decay per view as in steps of one view, and t counts views.
inline AdamRule adam_rule(int n_views) {
  const double beta1 = std::pow(kAdamBeta1, n_views), beta2 = std::pow(kAdamBeta2, n_views);
  return {static_cast<float>(beta1), static_cast<float>(1 - beta1), static_cast<float>(beta2),
          static_cast<float>(1 - beta2), static_cast<float>(kAdamEpsilon / std::sqrt(n_views))};
}

/// Factors that differ from step to step, where t counts from 1.
struct AdamStepSize {
  float step_size = 0;           // rate / (1 - beta1^t)
  float inverse_root_bias2 = 0;  // 1 / sqrt(1 - beta2^t)
};

/// Returns the factors of step t, which all elements share.
inline AdamStepSize adam_step_size(double rate, std::int64_t step) {
  const double t = static_cast<double>(step);
  const double bias1 = 1 - std::pow(kAdamBeta1, t), bias2 = 1 - std::pow(kAdamBeta2, t);
  return {static_cast<float>(rate / bias1), static_cast<float>(1 / std::sqrt(bias2))};
}

/// Arguments of one step (Kingma and Ba 2015, with bias correction in the step size):
///   m = beta1 m + (1 - beta1) grad,  v = beta2 v + (1 - beta2) grad^2
///   param -= step_size * m / (sqrt(v) * inverse_root_bias2 + epsilon)
struct AdamArgs {
  std::int64_t n = 0;
  float* param = nullptr;
  const float* grad = nullptr;
  float* m = nullptr;
  float* v = nullptr;
  AdamStepSize size{};
};

/// Indices into AdamGroups, in the order of GaussianTensors. kShGroup stands for the SH coefficients beyond degree 0.
enum GroupIndex : std::size_t { kMeanGroup, kScaleGroup, kQuatGroup, kOpacityGroup, kSh0Group, kShGroup, kGroups };
using AdamGroups = std::array<AdamArgs, kGroups>;

// Regularisation of opacity and scale makes Gaussians that the image does not need transparent and small:
//   loss += opacity_reg mean(o) + scale_reg mean(s)
// The means are over the M visible Gaussians (3 M numbers for the scales), so that the effect on one Gaussian does not
// depend on how many others are out of view. Kheradmand et al. 2024 average over all Gaussians.

/// Weights of the two means, for scales in world units. 0 turns a term off.
struct RegularizationWeights {
  double opacity = 0, scale = 0;
};

/// Gradients of these terms with respect to the opacity and to each scale of a visible Gaussian.
struct RegularizationGrad {
  float opacity = 0, scale = 0;
  B3DGS_HD bool is_zero() const { return opacity == 0 && scale == 0; }
};

/// Returns the gradients for a view with `n_seen` splats. This is M, except that a panorama counts Gaussians across its
/// seam twice.
inline RegularizationGrad regularization_grad(const RegularizationWeights& weights, std::int64_t n_seen) {
  if (n_seen == 0) return {};
  const double n = static_cast<double>(n_seen);
  return {static_cast<float>(weights.opacity / n), static_cast<float>(weights.scale / (3 * n))};
}

/// Adds the gradients with respect to the stored parameters of a visible Gaussian.
B3DGS_HD void add_regularization(const RegularizationGrad& grad, float logit_opacity, const Vec3f& log_scales,
                                 float& grad_logit_opacity, Vec3f& grad_log_scales) {
  const float tail = std::exp(-std::fabs(logit_opacity));  // do / d(logit) = o (1 - o)
  grad_logit_opacity += grad.opacity * (tail / ((1 + tail) * (1 + tail)));
  grad_log_scales.x += grad.scale * std::exp(log_scales.x);  // ds / d(ln s) = s
  grad_log_scales.y += grad.scale * std::exp(log_scales.y);
  grad_log_scales.z += grad.scale * std::exp(log_scales.z);
}

}  // namespace b3dgs
