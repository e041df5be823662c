// What training starts from.
#pragma once

#include "model/formats/splat_cloud.h"
#include "scene/scene.h"
#include "train/config/train_config.h"

namespace b3dgs {

/// The Gaussians of --init_ply as they are; else one for each of its points, or of the scene's.
/// @throws InputError if there is nothing to start from
SplatCloud initial_splats(const TrainConfig& config, const Scene& scene);

}  // namespace b3dgs
