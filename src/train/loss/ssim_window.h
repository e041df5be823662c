// Window and constants of SSIM (Wang et al. 2004): 11 x 11 Gaussian, sigma 1.5 px, values in [0, 1].
#pragma once

#include "core/vec.h"

namespace b3dgs {

inline constexpr int kSsimRadius = 5;  // px
inline constexpr float kSsimC1 = 0.01f * 0.01f;
inline constexpr float kSsimC2 = 0.03f * 0.03f;

/// Weight of a tap of the separable window at distance 0 to 5 px from the centre: exp(-d^2 / 4.5), scaled so that all
/// 11 sum to 1. Literals, because std::exp is not constexpr; a test recomputes them.
B3DGS_HD constexpr float ssim_weight(int distance) {
  return distance == 0   ? 2.660117249e-01f
         : distance == 1 ? 2.130055377e-01f
         : distance == 2 ? 1.093606895e-01f
         : distance == 3 ? 3.600077213e-02f
         : distance == 4 ? 7.598758135e-03f
                         : 1.028380084e-03f;
}

}  // namespace b3dgs
