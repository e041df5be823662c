// The frame that a scene is trained in. Models are rendered in the frame of their SplatCloud.
#pragma once

#include <vector>

#include "scene/cameras/camera.h"
#include "scene/cameras/coordinate_frame.h"

namespace b3dgs {

/// To what a scene's typical depth is scaled, units of the frame.
inline constexpr double kTypicalDepth = 5;

/// The frame in which the typical depth is kTypicalDepth. The typical depth is
/// - the median over the cameras of the median depth of the points in their images;
/// - if no camera sees a point, the median depth of the point that the cameras look at;
/// - if they look at none, the largest distance of a camera from the mean of the centres, but at most ten times the
///   median distance of a camera from the nearest other one;
/// - without cameras, twice the median distance of the points from their median.
/// The origin is the mean of the camera centres or, without cameras, the median of the points. If there is no length at
/// all, the unit is 1. Cameras and points ([N, 3]) are in world coordinates.
CoordinateFrame choose_frame(const std::vector<Camera>& cameras, const std::vector<double>& points);

/// The same camera for coordinates in `to` instead of `from`.
Camera change_frame(const CoordinateFrame& from, const CoordinateFrame& to, Camera camera);

}  // namespace b3dgs
