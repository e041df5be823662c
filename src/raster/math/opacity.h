// Conversions between opacity and its stored logit, x = ln(o / (1 - o)), and the gradient.
#pragma once

#include <cmath>

#include "core/vec.h"

namespace b3dgs {

/// Inverse of the logistic function, for 0 < probability < 1.
inline float logit(double probability) {
  return static_cast<float>(std::log(probability / (1 - probability)));
}

inline constexpr float kLog2e = 1.44269504f;

/// Returns log2(sigmoid(logit)), accurate in both tails.
B3DGS_HD float log2_sigmoid(float logit) {
#if defined(__CUDA_ARCH__)
  const float tail = log1pf(__expf(-fabsf(logit)));  // __expf loses accuracy only where its value is far below 1
#else
  const float tail = std::log1p(std::exp(-std::fabs(logit)));
#endif
  return -kLog2e * (logit >= 0 ? tail : tail - logit);
}

/// Returns dL/d(logit) from dL/d(ln opacity): d ln(sigmoid(x)) / dx = 1 - sigmoid(x) = 1 / (1 + e^x).
B3DGS_HD float logit_grad(float grad_log_opacity, float logit) {
#if defined(__CUDA_ARCH__)
  return grad_log_opacity / (1 + __expf(logit));
#else
  return grad_log_opacity / (1 + std::exp(logit));
#endif
}

}  // namespace b3dgs
