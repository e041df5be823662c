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
/// Takes one step of an array. The result does not depend on the number of threads.
void adam_step(const AdamArgs& args, const AdamRule& rule = {});
}  // namespace cpu

struct AdamState {
  GaussianTensors m, v;  // first and second moments, in the shapes of the parameters
  // Number of steps so far, the same for all groups and rows (as in torch.optim.Adam). A step along n views counts n
  // times.
  std::int64_t steps = 0;
  torch::Tensor directions;  // [N, 4] for the decay of SH coefficients (sh_decay.h); undefined without it
};

/// Learning rate of each parameter group, in the order of GaussianTensors.
using AdamRates = std::array<double, kGroups>;

/// Returns zero moments for these parameters.
AdamState make_adam_state(const GaussianTensors& gaussians);

/// Checks the state. @throws LogicError unless all tensors are contiguous floats on one device, with the shapes of the
/// parameters
void check_adam_state(const GaussianTensors& gaussians, const AdamState& state);

/// Adds n_views to state.steps and returns the arguments of this step for each group, without gradients. @throws as
/// check_adam_state()
AdamGroups begin_adam_step(const AdamRates& rates, GaussianTensors& gaussians, AdamState& state, int n_views = 1);

/// Takes a step on the CPU along the gradient of a mean over n views (adam_rule()). `rates` are not scaled by n.
void adam_step(const AdamRates& rates, const GaussianTensors& grads, GaussianTensors& gaussians, AdamState& state,
               int n_views = 1);

// Learning rates and weights of the regularisation in each iteration.

/// Returns the value at `step` of a schedule from `initial` at step 0 to `final` at max_steps and later. It is
/// log-linear, or linear if one of the two is 0.
inline double log_linear_rate(double initial, double final, int max_steps, int step) {
  const double t = std::clamp(static_cast<double>(step) / max_steps, 0.0, 1.0);
  if (initial <= 0 || final <= 0) return initial + t * (final - initial);
  return std::exp((1 - t) * std::log(initial) + t * std::log(final));
}

/// Returns the factor of the learning rates of all parameters but the means. It is 1 until `lr_decay_from_iter`, and
/// falls log-linearly from there to `lr_final_scale` at `position_lr_max_steps`.
inline double lr_scale(const TrainConfig& config, int iteration) {
  if (config.lr_final_scale == 1) return 1;
  const int from = config.lr_decay_from_iter, to = config.position_lr_max_steps;
  if (to <= from) return iteration < to ? 1 : config.lr_final_scale;
  return log_linear_rate(1, config.lr_final_scale, to - from, std::max(0, iteration - from));
}

/// Returns the learning rates of an iteration, counted from 1. `extent` is the scene extent in world units.
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

/// Returns the factor that converts a length in a scene of this extent to a scene of extent 5, to which the values of
/// --scale_reg and noise_lr refer (about the extent of bonsai, fox and kitti_street). A training therefore does not
/// depend on the unit of length. The factor is limited to 10, because if all cameras are close together, as in a
/// panorama, the extent says nothing about the size of the scene.
inline double lengths_per_reference(double extent) {
  constexpr double kReferenceExtent = 5, kMost = 10;
  return kReferenceExtent / std::max(extent, kReferenceExtent / kMost);
}

/// Below this loss, the regularisation weakens in proportion to the loss, because a constant weight would bias the
/// result of a small loss. Among the measured scenes (docs/lab/defaults.md), only those of 35 dB or more are below it.
inline constexpr double kRegularizedLoss = 0.01;

/// Returns the weights of the regularisation. `loss` is a mean over recent steps.
inline RegularizationWeights regularization_weights(const TrainConfig& config, double extent, double loss) {
  const double scale = std::min(1.0, loss / kRegularizedLoss);
  return {scale * config.opacity_reg, scale * config.scale_reg * lengths_per_reference(extent)};
}

/// Returns the factor of Sigma eps in the noise on the means. Sigma is a squared length.
inline double mean_noise_strength(const TrainConfig& config, double extent, int iteration) {
  const double lengths = lengths_per_reference(extent);
  return config.noise_lr * adam_rates(config, extent, iteration)[0] * lengths * lengths;
}

}  // namespace b3dgs
