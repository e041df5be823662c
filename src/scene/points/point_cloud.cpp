#include "scene/points/point_cloud.h"

#include <array>
#include <cstddef>

namespace b3dgs {

PointCloud in_frame(const CoordinateFrame& frame, const WorldPoints& points) {
  PointCloud cloud{{}, points.colors};
  cloud.positions.reserve(points.positions.size());
  for (std::size_t i = 0; i < points.positions.size(); i += 3) {
    for (const double value : frame.from_world(&points.positions[i])) {
      cloud.positions.push_back(static_cast<float>(value));
    }
  }
  return cloud;
}

WorldPoints in_world(const CoordinateFrame& frame, const PointCloud& points) {
  WorldPoints world{{}, points.colors};
  world.positions.reserve(points.positions.size());
  for (std::size_t i = 0; i < points.positions.size(); i += 3) {
    const std::array<double, 3> position = frame.to_world(&points.positions[i]);
    world.positions.insert(world.positions.end(), position.begin(), position.end());
  }
  return world;
}

}  // namespace b3dgs
