// A camera with its pose. It is in double precision because cameras are few, and everything else is derived from them.
#pragma once

#include <array>
#include <cstddef>
#include <optional>
#include <string>
#include <vector>

#include "raster/view_lens.h"

namespace b3dgs {

// Limits of the values in files. Only damaged files exceed them.
inline constexpr int kMaxImageSide = 1 << 20;   // px
inline constexpr double kMaxCoordinate = 1e12;  // px or world units; its square is finite in single precision

/// Rigid motion x_camera = rotation * x_world + translation. Camera frame: +x right, +y down, +z forward.
struct Pose {
  std::array<double, 9> rotation{1, 0, 0, 0, 1, 0, 0, 0, 1};  // row-major, orthonormal
  std::array<double, 3> translation{};                        // world units
};

/// Returns the rotation matrix (row-major) of the quaternion w, x, y, z, which need not have unit length.
std::array<double, 9> rotation_from_quaternion(const std::array<double, 4>& wxyz);

/// Returns the unit quaternion w, x, y, z with w >= 0 of a rotation matrix (row-major).
std::array<double, 4> quaternion_from_rotation(const std::array<double, 9>& rotation);

/// Returns the vector turned by a rotation (row-major), and by its inverse.
std::array<double, 3> rotated(const std::array<double, 9>& rotation, const std::array<double, 3>& v);
std::array<double, 3> rotated_back(const std::array<double, 9>& rotation, const std::array<double, 3>& v);

double distance(const std::array<double, 3>& a, const std::array<double, 3>& b);

/// Position of a point in an image, px, and its depth (lens_depth() in raster/math/lens.h).
struct ImagePoint {
  double x = 0, y = 0, depth = 0;
};

/// A camera: a pinhole, unless it keeps the lens of its photograph. The centre of the upper left pixel is at (0.5,
/// 0.5), as in COLMAP.
struct Camera {
  int width = 0, height = 0;  // px
  double fx = 0, fy = 0;      // px
  double cx = 0, cy = 0;      // px, need not be the image centre
  Pose cam_from_world;
  LensParams<double> lens{};  // raster/math/lens.h

  bool is_pinhole() const { return lens.kind == LensKind::kPinhole; }

  /// Returns a pinhole that looks the same way, with the same focal lengths. For a panorama, whose focal lengths do not
  /// fit a pinhole, it has kDefaultFov.
  Camera without_lens() const;

  static constexpr double kDefaultFov = 50;  // vertical, degrees
  /// Makes a camera that looks at the centre of its image. @param fov vertical field of view, degrees
  static Camera with_field_of_view(int width, int height, double fov, const Pose& cam_from_world);

  /// Returns the camera centre in world coordinates.
  std::array<double, 3> center() const;

  /// Returns the position of a point in the image, or nothing if the image does not show it.
  template <class Value>
  std::optional<ImagePoint> project(const Value* position) const;

  /// Does the same for a point in camera coordinates.
  std::optional<ImagePoint> image_of(const std::array<double, 3>& at) const;

  /// Returns the same camera for an image of another size. The intrinsics are scaled per axis.
  Camera scaled_to(int new_width, int new_height) const;
};

template <class Value>
std::optional<ImagePoint> Camera::project(const Value* position) const {
  std::array<double, 3> at = cam_from_world.translation;
  for (std::size_t row = 0; row < 3; ++row) {
    for (std::size_t axis = 0; axis < 3; ++axis) at[row] += cam_from_world.rotation[3 * row + axis] * position[axis];
  }
  return image_of(at);
}

/// Returns the up direction of the cameras in world coordinates. It is perpendicular to their horizontal axes if these
/// differ enough to determine it, so that cameras may look up or down. Otherwise it is the mean of their upward axes.
/// Returns nothing without cameras, or if their upward axes differ too much.
std::optional<std::array<double, 3>> up_direction(const std::vector<Camera>& cameras);

// Poses as OpenGL, Blender, nerfstudio and instant-ngp write them: the camera looks along -z.

/// Camera-to-world matrix, 4 x 4, row-major. Camera frame: +x right, +y up, -z forward.
using OpenGlMatrix = std::array<double, 16>;

/// Returns the pose cam_from_world of a camera. The rotation part may have a uniform scale, as some exporters write it.
/// The scale is dropped and the camera centre stays. @throws InputError, beginning with `place`, unless all values are
/// finite, the rotation part is a rotation up to scale, and the last row is 0 0 0 1
Pose pose_from_opengl(const OpenGlMatrix& camera_to_world, const std::string& place = "camera-to-world matrix");

/// Inverse of pose_from_opengl().
OpenGlMatrix opengl_from_pose(const Pose& cam_from_world);

}  // namespace b3dgs
