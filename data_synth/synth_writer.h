// Puts a synthetic scene on disk as a COLMAP folder: images/, sparse/0/, truth.ply with the known Gaussians, and
// synth.json with the options it was made from.
#pragma once

#include <cstddef>
#include <functional>

#include "data_synth/synth_scene.h"

namespace b3dgs {

/// Renders the images and writes everything to config.output. A folder that holds a synthetic scene is replaced.
/// @throws InputError if the folder holds anything else: a real scene is not to be lost
/// @throws IoError if something cannot be written
void write_synth_scene(const SynthConfig& config, const SynthScene& scene,
                       const std::function<void(std::size_t done, std::size_t total)>& on_image = {});

}  // namespace b3dgs
