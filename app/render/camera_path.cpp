#include "app/render/camera_path.h"

#include <algorithm>
#include <cmath>
#include <opencv2/core.hpp>
#include <opencv2/core/quaternion.hpp>
#include <utility>

#include "core/check.h"
#include "model/edit/edit.h"

namespace b3dgs {
namespace {

constexpr std::int64_t kSamples = 200000;  // number of examined Gaussians
constexpr double kParallel = 1e-3;         // axes are nearly parallel below this determinant of the mean projection
constexpr double kLongestEllipse = 2.5;    // ratio of the axes
constexpr double kInside = 0.9;            // share of the cameras' arc that an orbit along it uses
constexpr double kLeastSwing = kPi / 18;   // minimum swing of that orbit to each side, rad

cv::Vec3d center_of(const Camera& camera) {
  return cv::Vec3d(camera.center().data());
}
/// Returns an axis of the camera, in world coordinates: 0 right, 1 down, 2 forward.
cv::Vec3d axis_of(const Camera& camera, std::size_t axis) {
  return cv::Vec3d(&camera.cam_from_world.rotation[3 * axis]);
}
/// Returns the pose of a camera at `center`.
Pose pose_at(const cv::Vec3d& center, const cv::Matx33d& rotation) {
  Pose pose;
  std::copy_n(rotation.val, 9, pose.rotation.begin());
  pose.translation = rotated(pose.rotation, {-center[0], -center[1], -center[2]});
  return pose;
}

cv::Quatd rotation_of(const Camera& camera) {
  return cv::Quatd::createFromRotMat(cv::Matx33d(camera.cam_from_world.rotation.data()));
}

/// Evaluates the Catmull-Rom segment from p1 to p2, t in [0, 1].
cv::Vec3d catmull_rom(const cv::Vec3d& p0, const cv::Vec3d& p1, const cv::Vec3d& p2, const cv::Vec3d& p3, double t) {
  const cv::Vec3d cubic = 3.0 * (p1 - p2) + p3 - p0;
  return p1 + 0.5 * t * (p2 - p0 + t * (2.0 * p0 - 5.0 * p1 + 4.0 * p2 - p3 + t * cubic));
}

/// Returns the smallest value at which half of the weight is reached.
double weighted_median(std::vector<std::pair<double, double>>& values) {
  std::sort(values.begin(), values.end());
  double total = 0, sum = 0;
  for (const auto& [value, weight] : values) total += weight;
  for (const auto& [value, weight] : values) {
    sum += weight;
    if (2 * sum >= total) return value;
  }
  return 0;
}

double median(std::vector<double> values) {
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

/// Returns the unit vector perpendicular to `up` that is nearest to `wanted`.
cv::Vec3d horizontal(const cv::Vec3d& wanted, const cv::Vec3d& up) {
  const cv::Vec3d across = wanted - wanted.dot(up) * up;
  if (cv::norm(across) > 1e-6 * cv::norm(wanted)) return cv::normalize(across);
  const cv::Vec3d other = std::abs(up[0]) < 0.5 ? cv::Vec3d{1, 0, 0} : cv::Vec3d{0, 1, 0};
  return cv::normalize(other - other.dot(up) * up);
}

/// Returns positions relative to the focus along `axis` and up x axis.
std::vector<std::pair<double, double>> horizontal_positions(const std::vector<Camera>& cameras, const cv::Vec3d& focus,
                                                            const cv::Vec3d& axis, const cv::Vec3d& up) {
  std::vector<std::pair<double, double>> positions;
  for (const Camera& camera : cameras) {
    const cv::Vec3d offset = center_of(camera) - focus;
    positions.emplace_back(offset.dot(axis), offset.dot(up.cross(axis)));
  }
  return positions;
}

struct Ellipse {
  double angle = 0, first_radius = 0, second_radius = 0;
};

/// Fits the ellipse a x^2 + b x y + c y^2 = 1 by least squares. Its radii are 0 if the positions do not determine one.
Ellipse fit_ellipse(const std::vector<std::pair<double, double>>& positions, double scale) {
  cv::Matx33d m;  // matrix of the normal equations
  cv::Vec3d sum;
  for (const auto& [x_world, y_world] : positions) {
    const double x = x_world / scale, y = y_world / scale;
    const cv::Vec3d row(x * x, x * y, y * y);
    m += row * row.t();
    sum += row;
  }
  const auto n = static_cast<double>(positions.size());
  if (!(std::abs(cv::determinant(m)) > 1e-6 * n * n * n)) return {};
  const cv::Vec3d solution = m.solve(sum, cv::DECOMP_LU);
  const double a = solution[0], b = solution[1], c = solution[2];
  // The eigenvalues of [a, b/2; b/2, c] are 1 / radius^2.
  const double middle = 0.5 * (a + c), spread = std::hypot(0.5 * (a - c), 0.5 * b);
  if (!(middle - spread > 0)) return {};
  return {0.5 * std::atan2(b, a - c), scale / std::sqrt(middle + spread), scale / std::sqrt(middle - spread)};
}

}  // namespace

std::vector<Camera> interpolate_cameras(const std::vector<Camera>& keys, int frames) {
  B3DGS_CHECK(!keys.empty() && frames > 0, "keys: ", keys.size(), ", frames: ", frames);
  const int last = static_cast<int>(keys.size()) - 1;
  std::vector<Camera> path;
  for (int frame = 0; frame < frames; ++frame) {
    const double place = frames > 1 ? static_cast<double>(last) * frame / (frames - 1) : 0;
    const int key = std::clamp(static_cast<int>(place), 0, std::max(0, last - 1));
    const double share = place - key;
    const auto at = [&](int index) -> const Camera& {
      return keys[static_cast<std::size_t>(std::clamp(index, 0, last))];
    };
    const auto center_at = [&](int index) { return center_of(at(index)); };

    Camera camera = at(key).scaled_to(keys[0].width, keys[0].height);
    const Camera next = at(key + 1).scaled_to(keys[0].width, keys[0].height);
    camera.fx += share * (next.fx - camera.fx);
    camera.fy += share * (next.fy - camera.fy);
    camera.cx += share * (next.cx - camera.cx);
    camera.cy += share * (next.cy - camera.cy);
    const cv::Vec3d center =
        catmull_rom(center_at(key - 1), center_at(key), center_at(key + 1), center_at(key + 2), share);
    const cv::Quatd rotation = cv::Quatd::slerp(rotation_of(camera), rotation_of(next), share, cv::QUAT_ASSUME_UNIT);
    camera.cam_from_world = pose_at(center, rotation.toRotMat3x3(cv::QUAT_ASSUME_UNIT));
    path.push_back(camera);
  }
  return path;
}

SplatBounds splat_bounds(const SplatCloud& splats) {
  SplatBounds bounds;
  const std::int64_t stride = std::max<std::int64_t>(1, splats.size() / kSamples);
  const auto median_of = [&](auto&& value_of) {
    std::vector<std::pair<double, double>> values;
    for (std::int64_t i = 0; i < splats.size(); i += stride) {
      const auto row = static_cast<std::size_t>(i);
      values.emplace_back(value_of(cv::Vec3d(cv::Vec3f(&splats.means[3 * row]))), opacity_of(splats, row));
    }
    return weighted_median(values);
  };
  for (int axis = 0; axis < 3; ++axis) bounds.center[axis] = median_of([&](const cv::Vec3d& p) { return p[axis]; });
  bounds.radius = median_of([&](const cv::Vec3d& p) { return cv::norm(p - bounds.center); });
  if (!(bounds.radius > 0)) bounds.radius = 1;
  return bounds;
}

cv::Vec3d focus_of(const std::vector<Camera>& cameras, const cv::Vec3d& fallback) {
  if (cameras.empty()) return fallback;
  // Solves sum of (I - d d^T) (p - c) = 0 over the axes c + s d, relative to the fallback so that coordinates stay
  // small.
  cv::Matx33d a;
  cv::Vec3d b;
  const double share = 1 / static_cast<double>(cameras.size());
  for (const Camera& camera : cameras) {
    const cv::Vec3d d = axis_of(camera, 2), c = center_of(camera) - fallback;
    a += share * (cv::Matx33d::eye() - d * d.t());
    b += share * (c - c.dot(d) * d);
  }
  // Pulls the point along the axes to the fallback, which is 0 here.
  if (cv::determinant(a) < kParallel) a += 0.01 * cv::Matx33d::eye();
  const cv::Vec3d focus = fallback + cv::Vec3d(a.solve(b, cv::DECOMP_LU));
  const auto n_in_front = std::count_if(cameras.begin(), cameras.end(), [&](const Camera& camera) {
    return (focus - center_of(camera)).dot(axis_of(camera, 2)) > 0;
  });
  return 2 * n_in_front >= static_cast<std::ptrdiff_t>(cameras.size()) ? focus : fallback;
}

CameraPlacement placement_of(const std::vector<Camera>& cameras, const cv::Vec3d& focus, const cv::Vec3d& up) {
  B3DGS_CHECK(!cameras.empty(), "no cameras");
  std::vector<double> distances, elevations;
  for (const Camera& camera : cameras) {
    const cv::Vec3d offset = center_of(camera) - focus;
    const double distance = cv::norm(offset);
    distances.push_back(distance);
    elevations.push_back(distance > 0 ? std::asin(std::clamp(offset.dot(up) / distance, -1.0, 1.0)) : 0);
  }
  const double distance = median(distances);
  return {distance > 0 ? distance : 1, median(elevations)};
}

Coverage coverage_of(const std::vector<Camera>& cameras, const cv::Vec3d& focus, const cv::Vec3d& up,
                     const cv::Vec3d& axis) {
  B3DGS_CHECK(!cameras.empty(), "no cameras");
  std::vector<double> angles;
  for (const auto& [x, y] : horizontal_positions(cameras, focus, axis, up)) angles.push_back(std::atan2(y, x));
  std::sort(angles.begin(), angles.end());
  Coverage coverage{angles.front() + 2 * kPi - angles.back(), 0.5 * (angles.front() + angles.back())};
  for (std::size_t i = 1; i < angles.size(); ++i) {
    const double gap = angles[i] - angles[i - 1];
    if (gap > coverage.gap) coverage = {gap, 0.5 * (angles[i] + angles[i - 1]) + kPi};
  }
  return coverage;
}

Orbit orbit_through(const std::vector<Camera>& cameras, const cv::Vec3d& focus, const cv::Vec3d& up) {
  B3DGS_CHECK(!cameras.empty(), "no cameras");
  Orbit orbit;
  orbit.focus = focus;
  orbit.up = up;
  const cv::Vec3d first = center_of(cameras[0]) - focus;
  orbit.first_axis = horizontal(first, up);
  const auto positions = horizontal_positions(cameras, focus, orbit.first_axis, up);
  std::vector<double> distances;
  distances.reserve(positions.size());
  for (const auto& [x, y] : positions) distances.push_back(std::hypot(x, y));
  const double radius = median(distances);
  orbit.first_radius = orbit.second_radius = radius > 0 ? radius : 1;
  const auto share = 1 / static_cast<double>(cameras.size());
  double square = 0;
  for (const Camera& camera : cameras) {
    const double height = (center_of(camera) - focus).dot(up);
    orbit.height += share * height;
    square += share * height * height;
  }
  const Coverage coverage = coverage_of(cameras, focus, up, orbit.first_axis);
  if (coverage.gap > kFullCircleGap) {
    orbit.start = coverage.middle;
    orbit.swing = std::max(kInside * 0.5 * (2 * kPi - coverage.gap), kLeastSwing);
    const double deviation = std::sqrt(std::max(0.0, square - orbit.height * orbit.height));
    orbit.height_swing = std::min(deviation, std::tan(kLeastSwing) * orbit.first_radius);
    return orbit;
  }
  const Ellipse ellipse = fit_ellipse(positions, orbit.first_radius);
  if (!(ellipse.first_radius > 0) || ellipse.second_radius > kLongestEllipse * ellipse.first_radius) return orbit;
  const double c = std::cos(ellipse.angle), s = std::sin(ellipse.angle);
  orbit.first_axis = c * orbit.first_axis + s * up.cross(orbit.first_axis);
  orbit.first_radius = ellipse.first_radius;
  orbit.second_radius = ellipse.second_radius;
  orbit.start = std::atan2(first.dot(up.cross(orbit.first_axis)) / orbit.second_radius,
                           first.dot(orbit.first_axis) / orbit.first_radius);
  return orbit;
}

Orbit turntable(const cv::Vec3d& focus, const cv::Vec3d& up, double distance, double elevation,
                const cv::Vec3d& toward) {
  Orbit orbit;
  orbit.focus = focus;
  orbit.up = up;
  orbit.first_axis = horizontal(toward - focus, up);
  orbit.first_radius = orbit.second_radius = distance * std::cos(elevation);
  orbit.height = distance * std::sin(elevation);
  return orbit;
}

std::vector<Camera> cameras_on(const Orbit& orbit, const Camera& lens, int frames) {
  B3DGS_CHECK(frames > 0, "frames: ", frames);
  std::vector<Camera> cameras;
  const cv::Vec3d second_axis = orbit.up.cross(orbit.first_axis);
  for (int frame = 0; frame < frames; ++frame) {
    const double turn = 2 * kPi * frame / frames;
    const double angle = orbit.start + (orbit.swing > 0 ? orbit.swing * std::sin(turn) : turn);
    const double height = orbit.height + orbit.height_swing * std::cos(turn);
    const cv::Vec3d offset = orbit.first_radius * std::cos(angle) * orbit.first_axis +
                             orbit.second_radius * std::sin(angle) * second_axis + height * orbit.up;
    const cv::Vec3d center = orbit.focus + offset;
    const cv::Vec3d forward = cv::normalize(-offset);
    const cv::Vec3d right = cv::normalize(forward.cross(orbit.up)), down = forward.cross(right);
    Camera camera = lens;
    camera.cx = 0.5 * lens.width;
    camera.cy = 0.5 * lens.height;
    camera.cam_from_world =
        pose_at(center, {right[0], right[1], right[2], down[0], down[1], down[2], forward[0], forward[1], forward[2]});
    cameras.push_back(camera);
  }
  return cameras;
}

}  // namespace b3dgs
