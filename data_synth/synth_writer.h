// Writes a synthetic scene as a COLMAP folder: images/, sparse/0/, truth.ply with the true Gaussians, synth.json with
// the options and, for `orbit`, truth_mesh.ply with its surface.
#pragma once

#include <cstddef>
#include <filesystem>
#include <functional>

#include "data_synth/synth_scene.h"

namespace b3dgs {

/// Returns whether the folder contains a synthetic scene. @throws InputError if it contains anything else
bool holds_synth_scene(const std::filesystem::path& folder);

/// Renders the images and writes everything to config.output. If there is a synthetic scene, it first removes the files
/// that the program wrote there. Other files stay, and are moved aside if they are in the way (core/files/own_files.h).
/// @throws InputError if the folder contains anything else, which protects real scenes
/// @throws IoError if something cannot be written. Then nothing of the new scene remains, except synth.json if there
/// are other files
void write_synth_scene(const SynthConfig& config, const SynthScene& scene,
                       const std::function<void(std::size_t done, std::size_t total)>& on_image = {});

}  // namespace b3dgs
