// A pinhole camera with its pose, in double precision: cameras are few, and everything else is derived from them.
#pragma once

#include <array>

namespace b3dgs {

/// Rigid motion x_camera = rotation * x_world + translation. Camera frame: +x right, +y down, +z forward.
struct Pose {
  std::array<double, 9> rotation{1, 0, 0, 0, 1, 0, 0, 0, 1};  // row-major, orthonormal
  std::array<double, 3> translation{};                        // world units
};

/// Rotation matrix (row-major) of the quaternion w, x, y, z, which need not have unit length.
std::array<double, 9> rotation_from_quaternion(const std::array<double, 4>& wxyz);

/// Unit quaternion w, x, y, z with w >= 0 of a rotation matrix (row-major).
std::array<double, 4> quaternion_from_rotation(const std::array<double, 9>& rotation);

/// Pinhole camera. The centre of the upper left pixel is at (0.5, 0.5), as in COLMAP.
struct Camera {
  int width = 0, height = 0;  // px
  double fx = 0, fy = 0;      // px
  double cx = 0, cy = 0;      // px, need not be the image centre
  Pose cam_from_world;

  /// Camera centre in world coordinates.
  std::array<double, 3> center() const;

  /// The same camera for an image of another size; the intrinsics are scaled per axis.
  Camera scaled_to(int new_width, int new_height) const;
};

}  // namespace b3dgs
