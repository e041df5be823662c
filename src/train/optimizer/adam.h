// Adam with its moments in plain tensors, so that row edits, checkpoints and resets handle them like parameters.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>

#include "config/train_config.h"
#include "raster/torch/rasterizer.h"
#include "train/optimizer/adam_args.h"

namespace b3dgs {

namespace cpu {
/// The result does not depend on the number of threads.
void adam_step(const AdamArgs& args, const AdamRule& rule = {});
}  // namespace cpu

struct AdamState {
  GaussianTensors m, v;  // first and second moments, shapes of the parameters
  // Taken so far, by all groups and rows alike (as in torch.optim.Adam); a step along n views counts n times.
  std::int64_t steps = 0;
};

/// One learning rate per parameter group, in the order of GaussianTensors.
using AdamRates = std::array<double, kGroups>;

/// Zero moments for these parameters.
AdamState make_adam_state(const GaussianTensors& gaussians);

/// @throws LogicError unless all tensors are contiguous floats on one device, with the shapes of the parameters
void check_adam_state(const GaussianTensors& gaussians, const AdamState& state);

/// Arguments of the next step for each group, without gradients; adds n_views to state.steps. @throws as
/// check_adam_state()
AdamGroups begin_adam_step(const AdamRates& rates, GaussianTensors& gaussians, AdamState& state, int n_views = 1);

/// Takes a step on the CPU, along the gradient of a mean over n views (adam_rule()). `rates` are used as they are.
void adam_step(const AdamRates& rates, const GaussianTensors& grads, GaussianTensors& gaussians, AdamState& state,
               int n_views = 1);

// Learning rates and weights of the regularisation by iteration.

/// From `initial` at step 0 to `final` at max_steps and later, log-linearly; linearly if one of them is 0.
inline double log_linear_rate(double initial, double final, int max_steps, int step) {
  const double t = std::clamp(static_cast<double>(step) / max_steps, 0.0, 1.0);
  if (initial <= 0 || final <= 0) return initial + t * (final - initial);
  return std::exp((1 - t) * std::log(initial) + t * std::log(final));
}

/// What the learning rates of all parameters but the means are multiplied by: 1 until `lr_decay_from_iter`, from there
/// log-linearly down to `lr_final_scale` at `position_lr_max_steps`.
inline double lr_scale(const TrainConfig& config, int iteration) {
  if (config.lr_final_scale == 1) return 1;
  const int from = config.lr_decay_from_iter, to = config.position_lr_max_steps;
  if (to <= from) return iteration < to ? 1 : config.lr_final_scale;
  return log_linear_rate(1, config.lr_final_scale, to - from, std::max(0, iteration - from));
}

/// Learning rates of an iteration (counted from 1). `extent` is the scene's, world units.
inline AdamRates adam_rates(const TrainConfig& config, double extent, int iteration) {
  const double means = extent * log_linear_rate(config.position_lr_init, config.position_lr_final,
                                                config.position_lr_max_steps, iteration);
  const double scale = lr_scale(config, iteration);
  return {means,
          scale * config.scaling_lr,
          scale * config.rotation_lr,
          scale * config.opacity_lr,
          scale * config.feature_lr,
          scale * config.feature_lr / config.feature_rest_divisor};
}

/// Converts a length in a scene of this extent to a scene of the extent 5, about that of bonsai, fox and kitti_street,
/// for which --scale_reg and noise_lr are given: a training does not depend on the unit of length. At most 10: where
/// all cameras are close together, as in a panorama, the extent says nothing about the size of the scene.
inline double lengths_per_reference(double extent) {
  constexpr double kReferenceExtent = 5, kMost = 10;
  return kReferenceExtent / std::max(extent, kReferenceExtent / kMost);
}

/// Below this loss, regularization weakens in proportion to it: next to a small loss, a constant weight would bias what
/// is learned. Of the scenes measured (docs/lab/defaults.md), only those of 35 dB or more are below it.
inline constexpr double kRegularizedLoss = 0.01;

/// `loss`: a mean of recent steps.
inline RegularizationWeights regularization_weights(const TrainConfig& config, double extent, double loss) {
  const double scale = std::min(1.0, loss / kRegularizedLoss);
  return {scale * config.opacity_reg, scale * config.scale_reg * lengths_per_reference(extent)};
}

/// What multiplies Sigma eps in the noise on the means; Sigma is a length squared.
inline double mean_noise_strength(const TrainConfig& config, double extent, int iteration) {
  const double lengths = lengths_per_reference(extent);
  return config.noise_lr * adam_rates(config, extent, iteration)[0] * lengths * lengths;
}

}  // namespace b3dgs
