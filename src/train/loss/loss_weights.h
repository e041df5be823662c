// The options that weight the terms of the loss.
#pragma once

#include "config/train_config.h"
#include "train/loss/loss_args.h"
#include "train/optimizer/regularization.h"

namespace b3dgs {

inline LossWeights loss_weights(const TrainConfig& config) {
  LossWeights weights;
  weights.dssim = config.lambda_dssim;
  return weights;
}

inline RegularizationWeights regularization_weights(const TrainConfig& config, int iteration) {
  if (iteration <= config.reg_from_iter) return {};
  return {config.opacity_reg, config.scale_reg};
}

}  // namespace b3dgs
