// Whether a checkpoint belongs to a scene, and what has changed in the scene since.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include <nlohmann/json.hpp>

#include "scene/scene.h"

namespace b3dgs {

/// Identifies a scene in a checkpoint: what must be equal for view indices and image sizes to have the same meaning and
/// for the Gaussians to fit the views, and to detect changes a checksum of the points and the fingerprints of all
/// photographs and masks (model/photographs.h). The caller may add "depth_maps", a list of fingerprints.
nlohmann::ordered_json scene_fingerprint(const Scene& scene);

/// The frame of a checkpoint's Gaussians, in which the scene has to be loaded (SceneOptions::frame): that of the world
/// for checkpoints of early versions. @throws InputError
CoordinateFrame checkpoint_frame(const nlohmann::ordered_json& header, const std::string& place);
CoordinateFrame checkpoint_frame(const std::filesystem::path& checkpoint);

/// @throws InputError if a checkpoint with this header was trained on other views than the scene's, or with other poses
/// or intrinsics. Images need not be loaded.
void check_scene(const nlohmann::ordered_json& header, const Scene& scene, const std::string& place);

/// Names of training views whose photographs have changed since a checkpoint with this header was written, if the
/// header has that information.
std::vector<std::string> changed_photographs(const nlohmann::ordered_json& header,
                                             const nlohmann::ordered_json& fingerprint);

/// The same for masks: names of training views whose mask is another one, was added or is gone.
std::vector<std::string> changed_masks(const nlohmann::ordered_json& header, const nlohmann::ordered_json& fingerprint);

/// The same for depth maps, if the header and `fingerprint` have them.
std::vector<std::string> changed_depth_maps(const nlohmann::ordered_json& header,
                                            const nlohmann::ordered_json& fingerprint);

/// Whether the scene had other points, if the header has that information.
bool have_points_changed(const nlohmann::ordered_json& header, const nlohmann::ordered_json& fingerprint);

}  // namespace b3dgs
