#include "scene/cameras/coordinate_frame.h"

namespace b3dgs {
namespace {

constexpr std::size_t kPoints = 20000, kCameras = 100;  // number of points and cameras that are used, evenly spaced

double median(std::vector<double>& values) {
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

/// Returns 0 if no camera sees a point.
double typical_depth(const std::vector<Camera>& cameras, const std::vector<double>& points) {
  const std::size_t n_points = points.size() / 3;
  const std::size_t point_step = std::max<std::size_t>(1, n_points / kPoints);
  const std::size_t camera_step = std::max<std::size_t>(1, cameras.size() / kCameras);
  std::vector<double> of_cameras, depths;
  for (std::size_t c = 0; c < cameras.size(); c += camera_step) {
    depths.clear();
    for (std::size_t i = 0; i < n_points; i += point_step) {
      if (const auto place = cameras[c].project(&points[3 * i])) depths.push_back(place->depth);
    }
    if (!depths.empty()) of_cameras.push_back(median(depths));
  }
  return of_cameras.empty() ? 0 : median(of_cameras);
}

std::array<double, 3> mean_center(const std::vector<Camera>& cameras) {
  std::array<double, 3> mean{};
  for (const Camera& camera : cameras) {
    const std::array<double, 3> center = camera.center();
    for (std::size_t i = 0; i < 3; ++i) mean[i] += center[i] / static_cast<double>(cameras.size());
  }
  return mean;
}

/// Finds the point with the least sum of squared distances to the optical axes. Returns its median depth, or 0 if the
/// axes are nearly parallel or the point is not in front of most cameras.
double depth_of_focus(const std::vector<Camera>& cameras, const std::array<double, 3>& origin) {
  constexpr double kLeastSpread = 1e-3, kMost = 0.8;
  // Solves sum of (I - d d^T) (p - c) = 0 over the axes c + s d.
  std::array<std::array<double, 4>, 3> rows{};  // the matrix and the right side
  const auto n = static_cast<double>(cameras.size());
  const auto direction = [](const Camera& camera, std::size_t axis) {
    return camera.cam_from_world.rotation[6 + axis];
  };
  for (const Camera& camera : cameras) {
    const std::array<double, 3> center = camera.center();
    for (std::size_t i = 0; i < 3; ++i) {
      for (std::size_t j = 0; j < 3; ++j) {
        const double projector = ((i == j ? 1 : 0) - direction(camera, i) * direction(camera, j)) / n;
        rows[i][j] += projector;
        rows[i][3] += projector * (center[j] - origin[j]);
      }
    }
  }
  const auto determinant = [&](std::size_t a, std::size_t b, std::size_t c) {
    const auto& r = rows;
    return r[0][a] * (r[1][b] * r[2][c] - r[1][c] * r[2][b]) - r[0][b] * (r[1][a] * r[2][c] - r[1][c] * r[2][a]) +
           r[0][c] * (r[1][a] * r[2][b] - r[1][b] * r[2][a]);
  };
  const double whole = determinant(0, 1, 2);
  if (!(whole > kLeastSpread)) return 0;
  const std::array<double, 3> focus{determinant(3, 1, 2) / whole, determinant(0, 3, 2) / whole,
                                    determinant(0, 1, 3) / whole};
  std::vector<double> depths;
  double n_before = 0;
  for (const Camera& camera : cameras) {
    const std::array<double, 3> center = camera.center();
    double depth = 0;
    for (std::size_t i = 0; i < 3; ++i) depth += direction(camera, i) * (focus[i] + origin[i] - center[i]);
    n_before += depth > 0 ? 1 : 0;
    depths.push_back(depth);
  }
  return n_before >= kMost * n ? median(depths) : 0;
}

/// Returns the median distance from the nearest other camera, or 0 if there is only one.
double usual_spacing(const std::vector<Camera>& cameras) {
  std::vector<double> spacings;
  const std::size_t step = std::max<std::size_t>(1, cameras.size() / kCameras);
  for (std::size_t i = 0; i < cameras.size(); i += step) {
    const std::array<double, 3> own = cameras[i].center();
    double nearest = 0;
    for (std::size_t k = 0; k < cameras.size(); ++k) {
      const double from_other = distance(cameras[k].center(), own);
      if (from_other > 0 && (nearest == 0 || from_other < nearest)) nearest = from_other;
    }
    spacings.push_back(nearest);
  }
  return median(spacings);
}

/// Returns a frame around the median of the points, for scenes without cameras.
CoordinateFrame frame_of_points(const std::vector<double>& points) {
  CoordinateFrame frame;
  if (points.empty()) return frame;
  const std::size_t step = 3 * std::max<std::size_t>(1, points.size() / 3 / kPoints);
  double spread = 0;
  for (std::size_t axis = 0; axis < 3; ++axis) {
    std::vector<double> values;
    for (std::size_t i = axis; i < points.size(); i += step) values.push_back(points[i]);
    frame.origin[axis] = median(values);
    for (double& value : values) value = std::abs(value - frame.origin[axis]);
    spread = std::hypot(spread, median(values));
  }
  if (spread > 0) frame.unit = 2 * spread / kTypicalDepth;
  return frame;
}

}  // namespace

CoordinateFrame choose_frame(const std::vector<Camera>& cameras, const std::vector<double>& points) {
  if (cameras.empty()) return frame_of_points(points);
  CoordinateFrame frame;
  const std::vector<Camera> usual = usual_cameras(cameras, points);
  frame.origin = mean_center(usual);
  double depth = typical_depth(cameras, points);
  if (!(depth > 0)) depth = depth_of_focus(usual, frame.origin);
  if (!(depth > 0)) depth = std::min(camera_radius(usual), 10 * usual_spacing(cameras));
  if (depth > 0) frame.unit = depth / kTypicalDepth;
  return frame;
}

double camera_radius(const std::vector<Camera>& cameras) {
  const std::array<double, 3> mean = mean_center(cameras);
  double largest = 0;
  for (const Camera& camera : cameras) largest = std::max(largest, distance(camera.center(), mean));
  return largest;
}

RelativeDistances relative_distances(const std::vector<Camera>& cameras, const std::vector<double>& points) {
  constexpr std::size_t kFewest = 5;  // among three or four cameras, any may be the wrong one
  std::vector<double> values(cameras.size());
  if (cameras.size() < kFewest) return {std::move(values), 0};
  std::array<double, 3> middle{};
  for (std::size_t axis = 0; axis < 3; ++axis) {
    for (std::size_t i = 0; i < cameras.size(); ++i) values[i] = cameras[i].center()[axis];
    middle[axis] = median(values);
  }
  for (std::size_t i = 0; i < cameras.size(); ++i) values[i] = distance(cameras[i].center(), middle);
  const double depth = typical_depth(cameras, points);
  // Without points, only the cameras show the size of the scene, and most of them may stand in one place, where they
  // differ only by rounding. So this is not the median.
  const auto n_beyond = static_cast<std::ptrdiff_t>(values.size()) / (depth > 0 ? 2 : 10);
  std::vector<double> sorted = values;
  const auto usual_place = sorted.end() - 1 - std::max<std::ptrdiff_t>(1, n_beyond);
  std::nth_element(sorted.begin(), usual_place, sorted.end());
  const bool is_rounding = *usual_place <= 1e-9 * std::hypot(middle[0], middle[1], middle[2]);
  const double usual = std::max(depth, is_rounding ? 0 : *usual_place);
  for (double& value : values) value = usual > 0 ? value / usual : 0;
  return {std::move(values), usual};
}

double limited_radius(const std::vector<Camera>& cameras, const std::vector<double>& points) {
  const double radius = camera_radius(cameras), usual = relative_distances(cameras, points).usual;
  return usual > 0 ? std::min(radius, kMostRadius * usual) : radius;
}

std::vector<Camera> usual_cameras(const std::vector<Camera>& cameras, const std::vector<double>& points) {
  const std::vector<double> distances = relative_distances(cameras, points).values;
  std::vector<Camera> usual;
  for (std::size_t i = 0; i < cameras.size(); ++i) {
    if (distances[i] <= kFarTimes) usual.push_back(cameras[i]);
  }
  return usual;
}

Camera change_frame(const CoordinateFrame& from, const CoordinateFrame& to, Camera camera) {
  if (from == to) return camera;
  Pose& pose = camera.cam_from_world;
  for (std::size_t row = 0; row < 3; ++row) {
    double t = from.unit * pose.translation[row];
    for (std::size_t axis = 0; axis < 3; ++axis) {
      t += pose.rotation[3 * row + axis] * (to.origin[axis] - from.origin[axis]);
    }
    pose.translation[row] = t / to.unit;
  }
  return camera;
}

}  // namespace b3dgs
