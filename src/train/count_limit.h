// The largest number of Gaussians of a training.
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

}  // namespace b3dgs
