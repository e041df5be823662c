// The initial Gaussians of a training.
#pragma once

#include "config/train_config.h"
#include "model/formats/splat_cloud.h"
#include "scene/scene.h"

namespace b3dgs {

/// The Gaussians of --init_ply unchanged, or one per point of --init_ply, or else one per point of the scene, with the
/// opacity and scale that the options give; in the frame of the scene.
/// @throws InputError if there are no points or Gaussians
SplatCloud initial_splats(const TrainConfig& config, const Scene& scene);

}  // namespace b3dgs
