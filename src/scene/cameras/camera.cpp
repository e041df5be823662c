#include "scene/cameras/camera.h"

#include <cmath>

#include "core/check.h"

namespace b3dgs {

std::array<double, 9> rotation_from_quaternion(const std::array<double, 4>& wxyz) {
  const double norm = std::sqrt(wxyz[0] * wxyz[0] + wxyz[1] * wxyz[1] + wxyz[2] * wxyz[2] + wxyz[3] * wxyz[3]);
  B3DGS_CHECK(norm > 0 && std::isfinite(norm), "a rotation quaternion of length ", norm);
  const double w = wxyz[0] / norm, x = wxyz[1] / norm, y = wxyz[2] / norm, z = wxyz[3] / norm;
  return {1 - 2 * (y * y + z * z), 2 * (x * y - w * z),     2 * (x * z + w * y),
          2 * (x * y + w * z),     1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
          2 * (x * z - w * y),     2 * (y * z + w * x),     1 - 2 * (x * x + y * y)};
}

std::array<double, 4> quaternion_from_rotation(const std::array<double, 9>& r) {
  // Four times the square of each component; dividing by the largest keeps the others accurate.
  const std::array<double, 4> squares{1 + r[0] + r[4] + r[8], 1 + r[0] - r[4] - r[8], 1 - r[0] + r[4] - r[8],
                                      1 - r[0] - r[4] + r[8]};
  int largest = 0;
  for (int i = 1; i < 4; ++i) {
    if (squares[i] > squares[largest]) largest = i;
  }
  const double wx = r[7] - r[5], wy = r[2] - r[6], wz = r[3] - r[1];  // four times w x, w y, w z
  const double xy = r[1] + r[3], xz = r[2] + r[6], yz = r[5] + r[7];
  std::array<double, 4> q{};
  switch (largest) {
    case 0:
      q = {squares[0], wx, wy, wz};
      break;
    case 1:
      q = {wx, squares[1], xy, xz};
      break;
    case 2:
      q = {wy, xy, squares[2], yz};
      break;
    default:
      q = {wz, xz, yz, squares[3]};
      break;
  }
  const double norm = std::sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]);
  const double scale = (q[0] < 0 ? -1 : 1) / norm;
  for (double& value : q) value *= scale;
  return q;
}

std::array<double, 3> Camera::center() const {
  const std::array<double, 9>& r = cam_from_world.rotation;
  const std::array<double, 3>& t = cam_from_world.translation;
  std::array<double, 3> center{};
  for (int i = 0; i < 3; ++i) center[i] = -(r[i] * t[0] + r[3 + i] * t[1] + r[6 + i] * t[2]);
  return center;
}

Camera Camera::scaled_to(int new_width, int new_height) const {
  B3DGS_CHECK(width > 0 && height > 0 && new_width > 0 && new_height > 0, "sizes must be positive");
  const double sx = static_cast<double>(new_width) / width, sy = static_cast<double>(new_height) / height;
  Camera scaled = *this;
  scaled.width = new_width;
  scaled.height = new_height;
  scaled.fx *= sx;
  scaled.cx *= sx;
  scaled.fy *= sy;
  scaled.cy *= sy;
  return scaled;
}

}  // namespace b3dgs
