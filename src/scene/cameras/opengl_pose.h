// Poses as OpenGL, Blender, nerfstudio and instant-ngp write them: camera-to-world matrices whose camera looks along
// -z.
#pragma once

#include <array>
#include <string>

#include "scene/cameras/camera.h"

namespace b3dgs {

/// Camera-to-world matrix, 4 x 4, row-major. Camera frame: +x right, +y up, -z forward.
using OpenGlMatrix = std::array<double, 16>;

/// The pose cam_from_world of a camera. The rotation part may have a uniform scale, as some exporters write it; the
/// scale is dropped and the camera centre stays. @throws InputError, beginning with `place`, unless all values are
/// finite, the rotation part is a rotation up to scale, and the last row is 0 0 0 1
Pose pose_from_opengl(const OpenGlMatrix& camera_to_world, const std::string& place = "camera-to-world matrix");

/// The inverse function.
OpenGlMatrix opengl_from_pose(const Pose& cam_from_world);

}  // namespace b3dgs
