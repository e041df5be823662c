#include "scene/cameras/camera.h"

#include <algorithm>
#include <cmath>
#include <opencv2/core.hpp>

#include "core/check.h"
#include "core/vec.h"
#include "raster/math/lens.h"

namespace b3dgs {
namespace {

// Files that round to four decimals deviate by this much. A sheared or mirrored matrix deviates by far more.
constexpr double kTolerance = 1e-2;

constexpr const char* kRemedy = "; export the cameras again";

double determinant(const OpenGlMatrix& m) {
  return m[0] * (m[5] * m[10] - m[6] * m[9]) - m[1] * (m[4] * m[10] - m[6] * m[8]) + m[2] * (m[4] * m[9] - m[5] * m[8]);
}

// Returns the scale of the rotation part.
double checked_scale(const OpenGlMatrix& m, const std::string& place) {
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
      const double product = (m[a] * m[b] + m[4 + a] * m[4 + b] + m[8 + a] * m[8 + b]) / (scale * scale);
      if (std::abs(product - (a == b ? 1 : 0)) <= kTolerance) continue;
      input_error(place, ": expected a rotation up to a uniform scale, found columns that ",
                  a == b ? "differ in length" : "are not perpendicular", kRemedy);
    }
  }
  return scale;
}

}  // namespace

std::array<double, 9> rotation_from_quaternion(const std::array<double, 4>& wxyz) {
  const double norm = std::sqrt(wxyz[0] * wxyz[0] + wxyz[1] * wxyz[1] + wxyz[2] * wxyz[2] + wxyz[3] * wxyz[3]);
  B3DGS_CHECK(norm > 0 && std::isfinite(norm), "a rotation quaternion of length ", norm);
  const double w = wxyz[0] / norm, x = wxyz[1] / norm, y = wxyz[2] / norm, z = wxyz[3] / norm;
  return {1 - 2 * (y * y + z * z), 2 * (x * y - w * z),     2 * (x * z + w * y),
          2 * (x * y + w * z),     1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
          2 * (x * z - w * y),     2 * (y * z + w * x),     1 - 2 * (x * x + y * y)};
}

std::array<double, 4> quaternion_from_rotation(const std::array<double, 9>& r) {
  // Four times the square of each component. Dividing by the largest keeps the others accurate.
  const std::array<double, 4> squares{1 + r[0] + r[4] + r[8], 1 + r[0] - r[4] - r[8], 1 - r[0] + r[4] - r[8],
                                      1 - r[0] - r[4] + r[8]};
  const double wx = r[7] - r[5], wy = r[2] - r[6], wz = r[3] - r[1];  // four times w x, w y, w z
  const double xy = r[1] + r[3], xz = r[2] + r[6], yz = r[5] + r[7];
  const std::array<std::array<double, 4>, 4> products{
      {{squares[0], wx, wy, wz}, {wx, squares[1], xy, xz}, {wy, xy, squares[2], yz}, {wz, xz, yz, squares[3]}}};
  std::array<double, 4> q = products[std::max_element(squares.begin(), squares.end()) - squares.begin()];
  const double norm = std::sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]);
  const double scale = (q[0] < 0 ? -1 : 1) / norm;
  for (double& value : q) value *= scale;
  return q;
}

std::array<double, 3> rotated(const std::array<double, 9>& r, const std::array<double, 3>& v) {
  return {r[0] * v[0] + r[1] * v[1] + r[2] * v[2], r[3] * v[0] + r[4] * v[1] + r[5] * v[2],
          r[6] * v[0] + r[7] * v[1] + r[8] * v[2]};
}

std::array<double, 3> rotated_back(const std::array<double, 9>& r, const std::array<double, 3>& v) {
  return {r[0] * v[0] + r[3] * v[1] + r[6] * v[2], r[1] * v[0] + r[4] * v[1] + r[7] * v[2],
          r[2] * v[0] + r[5] * v[1] + r[8] * v[2]};
}

double distance(const std::array<double, 3>& a, const std::array<double, 3>& b) {
  return std::hypot(a[0] - b[0], a[1] - b[1], a[2] - b[2]);
}

Camera Camera::with_field_of_view(int width, int height, double fov, const Pose& cam_from_world) {
  const double focal = 0.5 * height / std::tan(0.5 * fov * kPi / 180);
  return {width, height, focal, focal, 0.5 * width, 0.5 * height, cam_from_world, {}};
}

std::array<double, 3> Camera::center() const {
  const auto [x, y, z] = rotated_back(cam_from_world.rotation, cam_from_world.translation);
  return {-x, -y, -z};
}

Camera Camera::without_lens() const {
  if (lens.kind == LensKind::kEquirectangular) return with_field_of_view(width, height, kDefaultFov, cam_from_world);
  Camera pinhole = *this;
  pinhole.lens = {};
  return pinhole;
}

std::optional<ImagePoint> Camera::image_of(const std::array<double, 3>& at) const {
  ImagePoint place{fx * at[0] / at[2] + cx, fy * at[1] / at[2] + cy, at[2]};
  if (!is_pinhole()) {
    const Vec3<double> point{at[0], at[1], at[2]};
    place.depth = lens_depth(lens, point);
    const bool is_panorama = lens.kind == LensKind::kEquirectangular;
    if (!(place.depth > 0) || (!is_panorama && lens_place(lens, point).is_clamped)) return std::nullopt;
    const Vec2<double> pixel = lens_point(lens, {fx, fy, cx, cy}, point).pixel;
    place.x = pixel.x;
    place.y = pixel.y;
    if (is_panorama && place.x >= width) place.x -= width;
    if (is_panorama) place.y = std::min(place.y, std::nextafter(height, 0.0));  // the lower pole
  }
  if (!(place.depth > 0)) return std::nullopt;
  if (!(place.x >= 0 && place.x < width && place.y >= 0 && place.y < height)) return std::nullopt;
  return place;
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

std::optional<std::array<double, 3>> up_direction(const std::vector<Camera>& cameras) {
  constexpr double kMinAgreement = 0.3;  // mean of unit vectors: 1 if all are equal
  constexpr double kMinSpread = 0.05;    // share of the second direction of the horizontal axes
  constexpr double kMinAlong = 0.7;      // cos 45 degrees; below it, the cameras are rolled
  cv::Vec3d mean_up;
  cv::Matx33d spread;
  const double share = 1 / static_cast<double>(cameras.size());
  for (const Camera& camera : cameras) {
    const cv::Vec3d right(&camera.cam_from_world.rotation[0]), down(&camera.cam_from_world.rotation[3]);
    mean_up -= share * down;
    spread += share * (right * right.t());
  }
  if (!(cv::norm(mean_up) >= kMinAgreement)) return std::nullopt;
  cv::Vec3d up = cv::normalize(mean_up), values;
  cv::Matx33d vectors;  // rows, in descending order of their values
  cv::eigen(spread, values, vectors);
  const cv::Vec3d across(vectors.row(2).val);
  const double along = across.dot(up);
  if (values[1] > kMinSpread && std::abs(along) > kMinAlong) up = along > 0 ? across : -across;
  return std::array<double, 3>{up[0], up[1], up[2]};
}

Pose pose_from_opengl(const OpenGlMatrix& camera_to_world, const std::string& place) {
  const double scale = checked_scale(camera_to_world, place);
  Pose pose;
  for (int column = 0; column < 3; ++column) {  // row of the inverse, whose y and z point the other way
    const double sign = (column == 0 ? 1 : -1) / scale;
    for (int row = 0; row < 3; ++row) pose.rotation[3 * column + row] = sign * camera_to_world[4 * row + column];
  }
  pose.rotation = rotation_from_quaternion(quaternion_from_rotation(pose.rotation));  // removes rounding errors
  for (int row = 0; row < 3; ++row) {
    for (int k = 0; k < 3; ++k) pose.translation[row] -= pose.rotation[3 * row + k] * camera_to_world[4 * k + 3];
  }
  return pose;
}

OpenGlMatrix opengl_from_pose(const Pose& cam_from_world) {
  Camera camera;
  camera.cam_from_world = cam_from_world;
  const std::array<double, 3> center = camera.center();
  const std::array<double, 9>& r = cam_from_world.rotation;
  return {r[0], -r[3], -r[6], center[0], r[1], -r[4], -r[7], center[1], r[2], -r[5], -r[8], center[2], 0, 0, 0, 1};
}

}  // namespace b3dgs
