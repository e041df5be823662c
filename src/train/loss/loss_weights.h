// The options that weight the terms of the loss.
#pragma once

#include "config/train_config.h"
#include "train/loss/loss_args.h"

namespace b3dgs {

inline LossWeights loss_weights(const TrainConfig& config, int iteration) {
  LossWeights weights;
  weights.dssim = config.lambda_dssim;
  weights.huber = iteration > config.huber_from_iter ? config.huber : 0;
  weights.alpha = config.mask_mode == "segment" ? config.mask_alpha_weight : 0;
  return weights;
}

}  // namespace b3dgs
