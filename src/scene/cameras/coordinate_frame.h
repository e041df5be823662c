// The frame that a scene is trained in: maps local coordinates in single precision to those of the world. Models are
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

/// world = origin + unit * local. A scene is trained in a frame of its own (choose_frame()), so that
/// neither its unit of length nor its distance from the world's origin changes what is learned; in src/raster and
/// src/train, "world" means this frame. Axes are those of the world. Files other than checkpoints hold world
/// coordinates.
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

  /// Whether world coordinates in single precision would be too coarse: beyond 1000 units of the frame, their
  /// steps exceed 6e-5 units.
  bool is_far() const {
    return std::max({std::abs(origin[0]), std::abs(origin[1]), std::abs(origin[2])}) > 1000 * unit;
  }

  bool operator==(const CoordinateFrame& other) const { return origin == other.origin && unit == other.unit; }
  bool operator!=(const CoordinateFrame& other) const { return !(*this == other); }
};

/// To what a scene's typical depth is scaled, units of the frame.
inline constexpr double kTypicalDepth = 5;

/// The frame in which the typical depth is kTypicalDepth. The typical depth is
/// - the median over the cameras of the median depth of the points in their images;
/// - if no camera sees a point, the median depth of the point that the cameras look at;
/// - if they look at none, the largest distance of a camera from the mean of the centres, but at most ten times the
///   median distance of a camera from the nearest other one;
/// - without cameras, twice the median distance of the points from their median.
/// The origin is the mean of the centres of the usual cameras or, without cameras, the median of the points. If there
/// is no length at all, the unit is 1. Cameras and points ([N, 3]) are in world coordinates.
CoordinateFrame choose_frame(const std::vector<Camera>& cameras, const std::vector<double>& points);

/// The largest distance of a camera centre from the mean of the centres; 0 without cameras.
double camera_radius(const std::vector<Camera>& cameras);

struct RelativeDistances {
  std::vector<double> values;  // of each camera, relative to `usual`
  double usual = 0;            // world units; 0, like all values, if nothing is usual
};

/// Returns the distance of each camera from the median of the centres, relative to the usual one: the median of these
/// distances (without points the 90th percentile) or, if that is larger, as for panoramas from one place, the typical
/// depth of the points that the cameras see. Nothing is usual with fewer than five cameras, or if nearly all stand in
/// one place and see no points.
RelativeDistances relative_distances(const std::vector<Camera>& cameras, const std::vector<double>& points);

/// Times the usual distance, in limited_radius().
inline constexpr double kMostRadius = 5;

/// Returns camera_radius(), but at most kMostRadius times the usual distance. A camera that is registered wrongly, a
/// hundred times as far away as the others, would otherwise multiply learning rates by a hundred. Such cameras are not
/// left out instead, because a group of cameras far away may be right.
double limited_radius(const std::vector<Camera>& cameras, const std::vector<double>& points);

/// A camera at more times the usual distance is probably registered wrongly.
inline constexpr double kFarTimes = 20;

/// Returns the cameras that are not far.
std::vector<Camera> usual_cameras(const std::vector<Camera>& cameras, const std::vector<double>& points);

/// The same camera for coordinates in `to` instead of `from`.
Camera change_frame(const CoordinateFrame& from, const CoordinateFrame& to, Camera camera);

}  // namespace b3dgs
