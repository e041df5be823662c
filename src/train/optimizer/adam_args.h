// One Adam step over one array, without torch.
#pragma once

#include <array>
#include <cstdint>

namespace b3dgs {

inline constexpr double kAdamBeta1 = 0.9;
inline constexpr double kAdamBeta2 = 0.999;
inline constexpr double kAdamEpsilon = 1e-15;  // the original's: gradients of a mean over all pixels are tiny

/// What sets one step t apart from another.
struct AdamStepSize {
  float step_size = 0;           // rate / (1 - beta1^t)
  float inverse_root_bias2 = 0;  // 1 / sqrt(1 - beta2^t)
};

/// m and v follow the gradient and its square, and
/// param -= step_size * m / (sqrt(v) * inverse_root_bias2 + epsilon).
struct AdamArgs {
  std::int64_t n = 0;
  float* param = nullptr;
  const float* grad = nullptr;
  float* m = nullptr;
  float* v = nullptr;
  AdamStepSize size{};
};

/// Means, log scales, quaternions, opacities, harmonics of degree 0 and those beyond.
using AdamGroups = std::array<AdamArgs, 6>;

}  // namespace b3dgs
