// poses.json of a model folder: the poses of training views that --pose_opt has refined.
#pragma once

#include <filesystem>
#include <nlohmann/json.hpp>
#include <vector>

#include "scene/scene.h"

namespace b3dgs {

/// One entry per training view, in their order. Poses map world to camera coordinates, as in COLMAP's images.txt:
///   img_name               as in cameras.json
///   qvec, tvec             refined: unit quaternion w x y z, translation (world units)
///   given_qvec, given_tvec the same, as in the scene
///   turned_degrees, moved  by how much the refined camera differs: angle, distance of its centre (world units)
/// `given` and `refined` are the same views, in `frame`.
nlohmann::ordered_json poses_to_json(const std::vector<View>& given, const std::vector<View>& refined,
                                     const CoordinateFrame& frame = {});

/// Sets the refined poses of those views that have the name and the given pose of an entry; other views, such as those
/// of another scene, stay. `frame` is that of the views. @throws InputError if the file is damaged
void apply_refined_poses(const std::filesystem::path& path, std::vector<View>& views,
                         const CoordinateFrame& frame = {});

}  // namespace b3dgs
