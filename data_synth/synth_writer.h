// Writes a synthetic scene as a COLMAP folder: images/, sparse/0/, truth.ply with the true Gaussians, and synth.json
// with the options.
#pragma once

#include <cstddef>
#include <filesystem>
#include <functional>

#include "data_synth/synth_scene.h"

namespace b3dgs {

/// Whether the folder holds a synthetic scene. @throws InputError if it holds anything else
bool holds_synth_scene(const std::filesystem::path& folder);

/// Renders the images and writes everything to config.output. If there is a synthetic scene, it first removes that
/// scene's files, which synth.json describes; other files in its folders stay.
/// @throws InputError if the folder contains anything else, which protects real scenes, if its synth.json cannot be
///   read, or if a file that is not of the earlier scene would be replaced
/// @throws IoError if something cannot be removed or written. Nothing of the new scene is left then, but for synth.json
///   if the folder holds other files
void write_synth_scene(const SynthConfig& config, const SynthScene& scene,
                       const std::function<void(std::size_t done, std::size_t total)>& on_image = {});

}  // namespace b3dgs
