// Limits that follow from the scene.
#pragma once

#include <algorithm>
#include <cstdint>

#include "config/train_config.h"
#include "scene/scene.h"

namespace b3dgs {

/// --max_gaussians; without it, one Gaussian for every --pixels_per_gaussian pixels of the training photographs, but no
/// fewer than the scene has points. 0 = no limit.
///
/// A Gaussian has 59 parameters, and a pixel three values: too many Gaussians overfit the training views. Pixels are
/// those of the cameras; masked ones count.
inline std::int64_t count_limit(const TrainConfig& config, const Scene& scene) {
  if (config.max_gaussians > 0 || config.pixels_per_gaussian == 0) return config.max_gaussians;
  double pixels = 0;
  for (const View& view : scene.train) pixels += static_cast<double>(view.camera.width) * view.camera.height;
  return std::max(static_cast<std::int64_t>(pixels / config.pixels_per_gaussian),
                  static_cast<std::int64_t>(scene.points.size()));
}

/// The first iteration of the decay by --lr_final_scale: --lr_decay_from_iter, but no later than when each photograph
/// has been used --lr_decay_from_epoch times (0 = no such limit). The fewer photographs, the fewer
/// iterations until training overfits them.
inline int decay_start(const TrainConfig& config, const Scene& scene) {
  if (config.lr_final_scale == 1 || config.lr_decay_from_epoch == 0) return config.lr_decay_from_iter;
  const std::int64_t latest = static_cast<std::int64_t>(scene.train.size()) * config.lr_decay_from_epoch;
  return static_cast<int>(std::min<std::int64_t>(config.lr_decay_from_iter, latest));
}

/// The options of a training of this scene, with these limits. Applying it again changes nothing. --max_epochs is not
/// among them: limit_epochs() (config/schedule.h) has to know which options were given, so commands apply it before.
inline TrainConfig with_scene_limits(TrainConfig config, const Scene& scene) {
  config.max_gaussians = count_limit(config, scene);
  config.lr_decay_from_iter = decay_start(config, scene);
  return config;
}

}  // namespace b3dgs
