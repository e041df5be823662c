// The complete options of a training.
#pragma once

#include <torch/types.h>

#include "config/train_config.h"
#include "scene/scene.h"

namespace b3dgs {

/// Options that are checked and complete. The limits of the scene are applied, and the device is chosen. A Trainer
/// takes nothing else, so it does not change the options any more.
struct FinalConfig {
  TrainConfig options;  // options.device is "cpu" or "cuda"
  torch::Device device;
};

/// Checks what can be checked without the scene: that the options can be combined, and that the file of --init_ply can
/// be read. @throws InputError
void check_options(const TrainConfig& config, torch::Device device);

/// Applies the limits of the scene (scene_limits.h), chooses the device and checks everything. --max_epochs is not
/// applied, because limit_epochs() (config/schedule.h) has to know which options were given. @throws InputError if the
/// device cannot be used, or if load_scene() was called with other options than scene_options(config)
FinalConfig finalize(TrainConfig config, const Scene& scene);

}  // namespace b3dgs
