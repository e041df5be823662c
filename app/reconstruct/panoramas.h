// Cuts panoramas of 360 x 180 degrees into perspective images (faces) for COLMAP, and converts the model of the faces
// into a model of the panoramas.
#pragma once

#include <cstddef>
#include <filesystem>
#include <functional>
#include <string>
#include <vector>

#include "app/reconstruct/photographs.h"
#include "scene/cameras/camera.h"
#include "scene/colmap/colmap.h"

namespace b3dgs {

/// Returns whether a photograph of this size can be a panorama.
bool has_panorama_size(ImageSize size);

/// Returns the cameras of a panorama's faces, in its frame: front, right, left, back. There are none up and down, where
/// tripods, the photographer's head, and the sky are. All panoramas of a scene have faces of one size.
std::vector<Camera> panorama_faces(const std::vector<ImageSize>& panoramas);

/// Returns COLMAP's parameters for this pinhole.
std::string pinhole_params(const Camera& face);

/// Writes the faces of the panoramas in `images` to `faces`/PANORAMA/0.jpg and so on, except existing ones. @return
/// their names. @throws IoError; errors from `progress`
std::vector<std::string> cut_panoramas(const std::filesystem::path& images, const std::filesystem::path& faces,
                                       const CheckedPhotographs& panoramas,
                                       const std::function<void(std::size_t done)>& progress);

/// Converts a model of faces, read with tracks, into a model of panoramas. The faces of a panorama share one position
/// and have known rotations, so its pose is the mean of those that agree. The others are dropped, and so are points
/// that two panoramas no longer see.
ColmapModel join_faces(const ColmapModel& faces, const CheckedPhotographs& panoramas);

/// Writes join_faces() of each model in `from` to `to`/0, `to`/1, ..., starting with the one with the most panoramas.
/// Skips folders without a readable model. @return the number of models. @throws IoError
std::size_t join_models(const std::filesystem::path& from, const std::filesystem::path& to,
                        const CheckedPhotographs& panoramas);

}  // namespace b3dgs
