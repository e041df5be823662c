// The options of a training that is about to begin.
#pragma once

#include <torch/types.h>

#include "config/train_config.h"
#include "scene/scene.h"

namespace b3dgs {

/// Options that are checked and complete: the limits of the scene are applied, and the device is chosen. A Trainer
/// takes no others, so nothing resolves them again.
struct FinalConfig {
  TrainConfig options;  // options.device is "cpu" or "cuda"
  torch::Device device;
};

/// Checks the options without the scene: that they go together, and that the file of --init_ply can be read.
/// @throws InputError
void check_options(const TrainConfig& config, torch::Device device);

/// Applies the limits of the scene (scene_limits.h), chooses the device and checks everything. --max_epochs is not
/// applied, because limit_epochs() (config/schedule.h) has to know which options were given. @throws InputError if the
/// device cannot be used, or load_scene() has read the scene with other options than scene_options(config)
FinalConfig finalize(TrainConfig config, const Scene& scene);

}  // namespace b3dgs
