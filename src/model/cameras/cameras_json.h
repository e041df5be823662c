// cameras.json of a model folder: the list of cameras of the original 3DGS, which viewers read too. And poses.json: the
// poses of training views that --pose_opt has refined.
#pragma once

#include <filesystem>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "scene/scene.h"

namespace b3dgs {

struct NamedCamera {
  std::string name;  // of the image
  Camera camera;
  bool held_out = false;
};

/// The keys of the original, and the principal point (cx, cy, in px), which the original assumes to be the centre of
/// the image. Test views come first, with "held_out": true. `frame` is that of the views.
nlohmann::ordered_json cameras_to_json(const std::vector<View>& test, const std::vector<View>& train,
                                       const CoordinateFrame& frame = {});

inline constexpr int kMaxCameraSide = 1 << 20;  // px

/// What is wrong with the intrinsics or the pose of a camera from a file; "" if nothing is.
std::string camera_fault(const Camera& camera);

/// The content of a cameras.json; `file` is named in errors. @throws InputError as read_cameras_json()
std::vector<NamedCamera> cameras_from_json(const nlohmann::ordered_json& json, const std::string& file);

/// Cameras in the order of the file, with or without a principal point. @throws InputError if the file is missing or
/// damaged
std::vector<NamedCamera> read_cameras_json(const std::filesystem::path& path);

/// poses.json: one entry per training view, in their order. Poses map world to camera coordinates, as in COLMAP's
/// images.txt:
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
