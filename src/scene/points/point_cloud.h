// Points with colours, from structure from motion or LiDAR.
#pragma once

#include <cstdint>
#include <vector>

#include "scene/cameras/coordinate_frame.h"

namespace b3dgs {

struct PointCloud {
  std::vector<float> positions;      // [N, 3] in the frame of the scene
  std::vector<std::uint8_t> colors;  // [N, 3] RGB

  std::int64_t size() const { return static_cast<std::int64_t>(positions.size() / 3); }
};

/// The same as files have them.
struct WorldPoints {
  std::vector<double> positions;     // [N, 3] world
  std::vector<std::uint8_t> colors;  // [N, 3] RGB

  std::int64_t size() const { return static_cast<std::int64_t>(positions.size() / 3); }
};

PointCloud in_frame(const CoordinateFrame& frame, const WorldPoints& points);
WorldPoints in_world(const CoordinateFrame& frame, const PointCloud& points);

}  // namespace b3dgs
