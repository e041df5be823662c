// Camera paths of `b3dgs render`: through the views, and around their focus or the Gaussians of a file.
#pragma once

#include <cmath>
#include <opencv2/core/matx.hpp>
#include <vector>

#include "core/vec.h"
#include "model/formats/splat_formats.h"
#include "scene/cameras/camera.h"

namespace b3dgs {

/// Returns `frames` cameras on a path through all key cameras, with the same number of frames between any two of them.
/// Centres follow a Catmull-Rom spline, rotations are interpolated by slerp, focal lengths and principal points
/// linearly. All frames have the image size of the first key. `keys` must not be empty.
std::vector<Camera> interpolate_cameras(const std::vector<Camera>& keys, int frames);

/// Centre and size of the Gaussians, robust against outliers. World units.
struct SplatBounds {
  cv::Vec3d center{};  // median of each coordinate, weighted by opacity
  double radius = 1;   // median distance from the centre, weighted by opacity; above 0
};

SplatBounds splat_bounds(const SplatCloud& splats);

/// Returns the point with the least sum of squared distances to the optical axes of all cameras. Returns `fallback` if
/// most cameras look away from it. If the axes are nearly parallel, returns the point on them that is nearest to
/// `fallback`.
cv::Vec3d focus_of(const std::vector<Camera>& cameras, const cv::Vec3d& fallback);

/// The distribution of the cameras around a point: the largest angle between two neighbours, seen from above, and the
/// middle of the remaining angle. Both are in rad, and the middle is measured from `axis` towards up x axis.
struct Coverage {
  double gap = 0, middle = 0;
};
inline constexpr double kFullCircleGap = 0.5 * kPi;  // cameras with smaller gaps form a full circle

Coverage coverage_of(const std::vector<Camera>& cameras, const cv::Vec3d& focus, const cv::Vec3d& up,
                     const cv::Vec3d& axis);

/// A horizontal ellipse on which cameras move, looking at a point above or below its centre. They go once around or, if
/// `swing` is not 0, along an arc and back.
struct Orbit {
  cv::Vec3d focus{};                           // the cameras look at this point
  cv::Vec3d up{0, -1, 0};                      // unit vector
  cv::Vec3d first_axis{1, 0, 0};               // axis of the ellipse: unit vector, perpendicular to `up`
  double first_radius = 1, second_radius = 1;  // along first_axis and along up x first_axis; world units
  double height = 0;                           // height of the ellipse above the focus, world units
  double start = 0;                            // angle of the first frame, rad
  double swing = 0;                            // largest angle from `start` to both sides, rad
  double height_swing = 0;                     // during the swing, the cameras move this much above and below `height`
};

/// Returns the ellipse that fits the horizontal positions of the cameras, of which there must be one, at their mean
/// height. It begins near the first camera. If the cameras do not form a full circle around the focus, it is an arc of
/// a circle along them.
Orbit orbit_through(const std::vector<Camera>& cameras, const cv::Vec3d& focus, const cv::Vec3d& up);

/// Returns a circle at an elevation (rad, above -pi/2 and below pi/2) and distance (world units) from the focus. It
/// begins near `toward`.
Orbit turntable(const cv::Vec3d& focus, const cv::Vec3d& up, double distance, double elevation,
                const cv::Vec3d& toward);

/// Median distance (world units) and elevation (rad) of the cameras, of which there must be one, seen from the focus.
struct CameraPlacement {
  double distance = 1, elevation = 0;
};
CameraPlacement placement_of(const std::vector<Camera>& cameras, const cv::Vec3d& focus, const cv::Vec3d& up);

/// Returns one turn, or one swing to both sides: `frames` cameras with the size and focal lengths of `lens` and the
/// principal point in the middle. The last frame is one step before the first, so that the loop can be repeated.
std::vector<Camera> cameras_on(const Orbit& orbit, const Camera& lens, int frames);

}  // namespace b3dgs
