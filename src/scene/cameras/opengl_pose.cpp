#include "scene/cameras/opengl_pose.h"

#include <cmath>

#include "core/check.h"

namespace b3dgs {
namespace {

// Files that round to four decimals are off by this much; a sheared or mirrored matrix is off by far more.
constexpr double kTolerance = 1e-2;
constexpr double kMaxCoordinate = 1e12;  // world units; its square is finite in single precision

constexpr const char* kRemedy = "; export the cameras again";

double dot_of_columns(const OpenGlMatrix& m, int a, int b) {
  double sum = 0;
  for (int row = 0; row < 3; ++row) sum += m[4 * row + a] * m[4 * row + b];
  return sum;
}

double determinant(const OpenGlMatrix& m) {
  return m[0] * (m[5] * m[10] - m[6] * m[9]) - m[1] * (m[4] * m[10] - m[6] * m[8]) + m[2] * (m[4] * m[9] - m[5] * m[8]);
}

// The scale of the rotation part.
double check_matrix(const OpenGlMatrix& m, const std::string& place) {
  for (const double value : m) {
    if (!(std::abs(value) <= kMaxCoordinate)) {
      input_error(place, ": expected 16 finite numbers of at most ", kMaxCoordinate, ", found ", value, kRemedy);
    }
  }
  if (std::abs(m[12]) + std::abs(m[13]) + std::abs(m[14]) + std::abs(m[15] - 1) > 1e-6) {
    input_error(place, ": expected the last row 0 0 0 1 of a camera-to-world matrix, found ", m[12], " ", m[13], " ",
                m[14], " ", m[15], kRemedy);
  }
  const double scale = std::cbrt(determinant(m));
  if (!(scale > 1e-6)) {
    input_error(place, ": expected a rotation, found a matrix of determinant ", determinant(m),
                scale < -1e-6 ? ", which mirrors" : "", kRemedy);
  }
  for (int a = 0; a < 3; ++a) {
    for (int b = a; b < 3; ++b) {
      const double dot = dot_of_columns(m, a, b) / (scale * scale);
      if (std::abs(dot - (a == b ? 1 : 0)) <= kTolerance) continue;
      if (a == b) {
        input_error(place, ": expected a rotation up to a uniform scale, found column ", a + 1, " of length ",
                    std::sqrt(dot), " relative to the others", kRemedy);
      }
      input_error(place, ": expected a rotation, found columns ", a + 1, " and ", b + 1,
                  " that are not perpendicular (cosine ", dot, ")", kRemedy);
    }
  }
  return scale;
}

}  // namespace

Pose pose_from_opengl(const OpenGlMatrix& camera_to_world, const std::string& place) {
  const double scale = check_matrix(camera_to_world, place);
  Pose pose;
  for (int column = 0; column < 3; ++column) {  // row of the inverse
    const double sign = (column == 0 ? 1 : -1) / scale;
    for (int row = 0; row < 3; ++row) pose.rotation[3 * column + row] = sign * camera_to_world[4 * row + column];
  }
  pose.rotation = rotation_from_quaternion(quaternion_from_rotation(pose.rotation));  // removes what rounding left
  for (int row = 0; row < 3; ++row) {
    for (int k = 0; k < 3; ++k) pose.translation[row] -= pose.rotation[3 * row + k] * camera_to_world[4 * k + 3];
  }
  return pose;
}

OpenGlMatrix opengl_from_pose(const Pose& cam_from_world) {
  Camera camera;
  camera.cam_from_world = cam_from_world;
  const std::array<double, 3> center = camera.center();
  OpenGlMatrix matrix{};
  for (int row = 0; row < 3; ++row) {
    for (int column = 0; column < 3; ++column) {
      matrix[4 * row + column] = (column == 0 ? 1 : -1) * cam_from_world.rotation[3 * column + row];
    }
    matrix[4 * row + 3] = center[row];
  }
  matrix[15] = 1;
  return matrix;
}

}  // namespace b3dgs
