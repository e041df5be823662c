// Points to start from where a scene has none.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "scene/point_cloud.h"

namespace b3dgs {

/// `n` grey points, uniform in the axis-aligned box of the centres (world units). Sides shorter than half the longest
/// one get that length, so that cameras in a plane give a volume; the box of a single centre has sides of 2. The same
/// centres always give the same points.
PointCloud random_points_around(const std::vector<std::array<double, 3>>& centers, std::int64_t n);

}  // namespace b3dgs
