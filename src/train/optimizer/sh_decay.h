// Decay of the SH coefficients beyond degree 0 of Gaussians that were seen from similar directions, for a step on CPU
// and GPU, without torch.
//
// Photographs of a narrow range of directions determine few coefficients: 16 (1 - R) of 16, where R is the length of
// the mean unit direction. The others are fitted to noise, and the colour seen from outside the range is arbitrary.
// Therefore a step with a gradient first shrinks these coefficients:
//   c_lk *= 1 - eta w l (l + 1) / 2,   w = min(1000 X, X / (1 - R)^2),
// with the step size eta of Adam, X from --sh_decay and l (l + 1) from the Laplacian on the sphere, as for a prior of
// smooth colours. With X / (1 - R), what is seen from all around would lose more. This is decoupled decay (Loshchilov
// and Hutter 2019), because a term of the loss would act more on Gaussians with few pixels. Coefficients that several
// views determine have gradients that outweigh it.
#pragma once

#include <cmath>
#include <cstdint>

#include "core/vec.h"

namespace b3dgs {

/// Sum of the unit vectors from the cameras to a Gaussian, over the views whose loss depends on its colour.
struct SeenDirections {
  Vec3f sum{0, 0, 0};
  float n = 0;  // number of views
  B3DGS_HD void add(const Vec3f& dir, const Vec3f& grad_color) {
    if (grad_color.x == 0 && grad_color.y == 0 && grad_color.z == 0) return;
    sum = sum + dir;
    n += 1;
  }
};

/// Arguments of a step along one or several views.
struct ShDecayArgs {
  float* directions = nullptr;  // [N, 4] SeenDirections over earlier steps, which fade; null: no decay
  float strength = 0;           // X, times sqrt(n) in a step along n views, where eta has the other sqrt(n)
  float kept = 1;               // share of `directions` that remains after this step
};

/// Returns the arguments for a step along n views.
inline ShDecayArgs sh_decay_args(float* directions, double strength, int n_views) {
  constexpr double kKeptPerView = 1 - 1.0 / 512;
  return {directions, static_cast<float>(strength * std::sqrt(n_views)),
          static_cast<float>(std::pow(kKeptPerView, n_views))};
}

/// Adds the directions of a step to those of Gaussian i. Returns w, times sqrt(n) in a step along n views; 0 if the
/// loss does not depend on the colour.
B3DGS_HD float sh_decay(const ShDecayArgs& args, std::int64_t i, const SeenDirections& seen) {
  if (args.directions == nullptr || seen.n == 0) return 0;
  constexpr float kFewViews = 8, kMostOverStrength = 1000;  // w = 3 with --sh_decay 0.003
  float* const row = args.directions + 4 * i;
  const Vec3f sum = args.kept * Vec3f{row[0], row[1], row[2]} + seen.sum;
  const float n = args.kept * row[3] + seen.n;
  row[0] = sum.x, row[1] = sum.y, row[2] = sum.z, row[3] = n;
  const float spread = n < kFewViews ? 0.0f : 1 - std::sqrt(dot(sum, sum)) / n;  // 1 - R
  const float squared = spread * spread;
  return args.strength * (squared * kMostOverStrength > 1 ? 1 / squared : kMostOverStrength);
}

/// Returns the coefficient after its decay. `k` counts the coefficients beyond degree 0 from 0, and `shrink` is eta w.
B3DGS_HD float decayed(float coefficient, float shrink, int k) {
  const float degree_factor = k < 3 ? 1.0f : (k < 8 ? 3.0f : 6.0f);  // l (l + 1) / 2
  return std::fma(-shrink * degree_factor, coefficient, coefficient);
}

}  // namespace b3dgs
