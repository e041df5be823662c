// Learning rates by iteration.
#pragma once

#include <algorithm>
#include <cmath>

#include "config/train_config.h"
#include "train/optimizer/adam.h"

namespace b3dgs {

/// Interpolates from `initial` at step 0 to `final` at max_steps and later, log-linearly; linearly if one of them is 0.
inline double log_linear_rate(double initial, double final, int max_steps, int step) {
  const double t = std::clamp(static_cast<double>(step) / max_steps, 0.0, 1.0);
  if (initial <= 0 || final <= 0) return initial + t * (final - initial);
  return std::exp((1 - t) * std::log(initial) + t * std::log(final));
}

/// Learning rates of an iteration (counted from 1), in the order of GaussianTensors. `extent` is the scene's, world
/// units.
inline AdamRates adam_rates(const TrainConfig& config, double extent, int iteration) {
  const double means = extent * log_linear_rate(config.position_lr_init, config.position_lr_final,
                                                config.position_lr_max_steps, iteration);
  return {means, config.scaling_lr, config.rotation_lr, config.opacity_lr, config.feature_lr, config.feature_lr / 20};
}

}  // namespace b3dgs
