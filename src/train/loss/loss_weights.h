// The options that weight the terms of the loss.
#pragma once

#include "config/train_config.h"
#include "train/loss/loss_args.h"

namespace b3dgs {

inline LossWeights loss_weights(const TrainConfig& config) {
  LossWeights weights;
  weights.dssim = config.lambda_dssim;
  weights.alpha = config.mask_mode == "segment" ? 1 : 0;
  return weights;
}

}  // namespace b3dgs
