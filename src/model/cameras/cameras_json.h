// cameras.json of a model folder, the list of cameras of the original 3DGS, which viewers also read. And poses.json,
// the poses of training views after refinement by --pose_opt.
#pragma once

#include <filesystem>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "scene/images/image.h"
#include "scene/scene.h"

namespace b3dgs {

struct NamedCamera {
  std::string name;  // name of the image
  Camera camera;
  bool held_out = false;
};

/// Writes the keys of the original, and the principal point (cx, cy, in px), which the original assumes to be the
/// centre of the image. Test views come first, with "held_out": true. Cameras that keep their lens have two more keys,
/// "camera_model" and "params", as in COLMAP's cameras.txt. Other readers see a pinhole. `frame` is that of the views.
nlohmann::ordered_json cameras_to_json(const std::vector<View>& test, const std::vector<View>& train,
                                       const CoordinateFrame& frame = {});

/// Checks a camera read from a file. Returns a description of the first fault in its intrinsics or pose, or "".
std::string camera_fault(const Camera& camera);

/// Parses the content of a cameras.json. Errors name `file`. @throws InputError as read_cameras_json()
std::vector<NamedCamera> cameras_from_json(const nlohmann::ordered_json& json, const std::string& file);

/// Reads cameras in the order of the file, with or without a principal point. @throws InputError if the file is missing
/// or damaged
std::vector<NamedCamera> read_cameras_json(const std::filesystem::path& path);

/// Returns poses.json: one entry per training view, in their order. Poses map world to camera coordinates, as in
/// COLMAP's images.txt:
///   img_name               as in cameras.json
///   qvec, tvec             refined: unit quaternion w x y z, translation (world units)
///   given_qvec, given_tvec the same, as in the scene
///   turned_degrees, moved  change of the refined camera: angle, distance of its centre (world units)
/// `given` and `refined` are the same views, in `frame`.
nlohmann::ordered_json poses_to_json(const std::vector<View>& given, const std::vector<View>& refined,
                                     const CoordinateFrame& frame = {});

/// Sets the refined poses of the views that have the name and the given pose of an entry. Other views, such as those of
/// another scene, do not change. `frame` is that of the views. @throws InputError if the file is damaged
void apply_refined_poses(const std::filesystem::path& path, std::vector<View>& views,
                         const CoordinateFrame& frame = {});

// Files of cameras to render from, distinguished by their content:
//
//   cameras.json          a JSON list, as b3dgs train and the original 3DGS write it (above)
//   camera path           "camera_path": [{"camera_to_world": 16 numbers, row-major; "fov": vertical, degrees;
//                         "aspect": width / height}], "render_width", "render_height", "fps", "seconds": as
//                         nerfstudio's viewer and the live view write it. One camera per frame; keyframes are ignored
//   transforms.json       "frames": [{"transform_matrix": 4 x 4, "file_path"}]; per frame or for all of them "w", "h",
//                         "fl_x", "fl_y", "cx", "cy", "camera_angle_x", "camera_angle_y"
//
// The last two have OpenGL camera-to-world matrices (scene/cameras/camera.h).

struct CameraFile {
  std::vector<NamedCamera> cameras;  // in the order of the file, at least one; the frames of a path have no names
  double fps = 0;                    // frames per second of a camera path; 0: not in the file
};

/// Reads any of these files. Cameras of a cameras.json keep their lens, as do panoramas of a transforms.json. Other
/// lens distortion there is ignored, so that the images are those of undistorted photographs. A frame of a
/// transforms.json without "w" and "h" has the size of its photograph if that exists. Other cameras without a size in
/// the file get `size`. @throws InputError with file and frame if the file is missing, damaged or of another kind, or a
/// camera has no size
CameraFile read_camera_file(const std::filesystem::path& path, ImageSize size = {});

/// Does the same from the text of a file that would be at `path`. @throws InputError as read_camera_file()
CameraFile parse_camera_file(const std::string& text, const std::filesystem::path& path, ImageSize size = {});

}  // namespace b3dgs
