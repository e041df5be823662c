// Files of cameras to render from, told apart by their content:
//
//   cameras.json          a JSON list, as b3dgs train and the original 3DGS write it (cameras_json.h)
//   camera path           "camera_path": [{"camera_to_world": 16 numbers, row-major; "fov": vertical, degrees;
//                         "aspect": width / height}], "render_width", "render_height", "fps", "seconds": as
//                         nerfstudio's viewer and the live view write it. One camera per frame; keyframes are ignored
//   transforms.json       "frames": [{"transform_matrix": 4 x 4, "file_path"}]; per frame or for all of them "w", "h",
//                         "fl_x", "fl_y", "cx", "cy", "camera_angle_x", "camera_angle_y"
//
// The last two have OpenGL camera-to-world matrices (scene/cameras/camera.h).
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "model/cameras/cameras_json.h"
#include "scene/images/image.h"

namespace b3dgs {

struct CameraFile {
  std::vector<NamedCamera> cameras;  // in the order of the file, at least one; the frames of a path have no names
  double fps = 0;                    // frames per second of a camera path; 0: the file does not say
};

/// Reads any of these files. Cameras are pinholes: lens distortion in a transforms.json is ignored, so that the images
/// are those of undistorted photographs. `size` is used for cameras without one in the file; a frame of a
/// transforms.json without "w" and "h" has the size of its photograph, if that is there and `size` is empty.
/// @throws InputError with file and frame if the file is missing, damaged or of another kind, or a camera has no size
CameraFile read_camera_file(const std::filesystem::path& path, ImageSize size = {});

/// The same from the text of a file that would be at `path`. @throws InputError as read_camera_file()
CameraFile parse_camera_file(const std::string& text, const std::filesystem::path& path, ImageSize size = {});

}  // namespace b3dgs
