// The frame that a scene is trained in. It maps local coordinates in single precision to world coordinates. Models are
// rendered in the frame of their SplatCloud.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <utility>
#include <vector>

#include "scene/cameras/camera.h"

namespace b3dgs {

/// world = origin + unit * local. Each scene is trained in its own frame (choose_frame()), so that neither its unit of
/// length nor its distance from the world's origin changes the result. In src/raster and src/train, "world" means this
/// frame. The axes are those of the world. Files other than checkpoints contain world coordinates.
struct CoordinateFrame {
  std::array<double, 3> origin{};  // world units
  double unit = 1;                 // world units per unit of the frame

  template <class Value>
  std::array<double, 3> to_world(const Value* local) const {
    return {origin[0] + unit * local[0], origin[1] + unit * local[1], origin[2] + unit * local[2]};
  }
  template <class Value>
  std::array<double, 3> from_world(const Value* world) const {
    return {(world[0] - origin[0]) / unit, (world[1] - origin[1]) / unit, (world[2] - origin[2]) / unit};
  }

  /// Returns whether world coordinates in single precision would be too coarse. Beyond 1000 units of the frame, their
  /// steps exceed 6e-5 units.
  bool is_far() const {
    return std::max({std::abs(origin[0]), std::abs(origin[1]), std::abs(origin[2])}) > 1000 * unit;
  }

  bool operator==(const CoordinateFrame& other) const { return origin == other.origin && unit == other.unit; }
  bool operator!=(const CoordinateFrame& other) const { return !(*this == other); }
};

/// The typical depth of a scene is scaled to this, in units of the frame.
inline constexpr double kTypicalDepth = 5;

/// Returns the frame in which the typical depth is kTypicalDepth. The typical depth is
/// - the median over the cameras of the median depth of the points in their images;
/// - if no camera sees a point, the median depth of the point that the cameras look at;
/// - if they look at none, the largest distance of a camera from the mean of the centres, but at most ten times the
///   median distance of a camera from the nearest other one;
/// - without cameras, twice the median distance of the points from their median.
/// The origin is the mean of the centres of the usual cameras or, without cameras, the median of the points. If no
/// length can be determined, the unit is 1. Cameras and points ([N, 3]) are in world coordinates.
CoordinateFrame choose_frame(const std::vector<Camera>& cameras, const std::vector<double>& points);

/// Returns the largest distance of a camera centre from the mean of the centres, or 0 without cameras.
double camera_radius(const std::vector<Camera>& cameras);

struct RelativeDistances {
  std::vector<double> values;  // for each camera, relative to `usual`
  double usual = 0;            // world units; 0, like all values, if there is no usual distance
};

/// Returns the distance of each camera from the median of the centres, relative to the usual distance. The usual
/// distance is the median of these distances (without points the 90th percentile). If the typical depth of the points
/// that the cameras see is larger, as for panoramas from one place, it is used instead. There is no usual distance with
/// fewer than five cameras, or if nearly all stand in one place and see no points.
RelativeDistances relative_distances(const std::vector<Camera>& cameras, const std::vector<double>& points);

/// Limit of limited_radius(), as a multiple of the usual distance.
inline constexpr double kMostRadius = 5;

/// Returns camera_radius(), but at most kMostRadius times the usual distance. Otherwise a camera that is registered
/// wrongly, a hundred times as far away as the others, would multiply learning rates by a hundred. Such cameras are not
/// left out instead, because a group of cameras far away may be right.
double limited_radius(const std::vector<Camera>& cameras, const std::vector<double>& points);

/// A camera beyond this multiple of the usual distance is probably registered wrongly.
inline constexpr double kFarTimes = 20;

/// Returns the cameras that are not far.
std::vector<Camera> usual_cameras(const std::vector<Camera>& cameras, const std::vector<double>& points);

/// Returns the same camera for coordinates in `to` instead of `from`.
Camera change_frame(const CoordinateFrame& from, const CoordinateFrame& to, Camera camera);

}  // namespace b3dgs
