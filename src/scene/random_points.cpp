#include "scene/random_points.h"

#include <algorithm>

#include "core/check.h"
#include "core/random.h"

namespace b3dgs {

PointCloud random_points_around(const std::vector<std::array<double, 3>>& centers, std::int64_t n) {
  B3DGS_CHECK(!centers.empty(), "points around no cameras");
  std::array<double, 3> low = centers.front(), high = centers.front();
  for (const std::array<double, 3>& center : centers) {
    for (std::size_t axis = 0; axis < 3; ++axis) {
      low[axis] = std::min(low[axis], center[axis]);
      high[axis] = std::max(high[axis], center[axis]);
    }
  }
  double longest = 0;
  for (std::size_t axis = 0; axis < 3; ++axis) longest = std::max(longest, high[axis] - low[axis]);
  const double shortest = longest > 0 ? 0.5 * longest : 2;
  for (std::size_t axis = 0; axis < 3; ++axis) {
    const double missing = std::max(0.0, shortest - (high[axis] - low[axis]));
    low[axis] -= 0.5 * missing;
    high[axis] += 0.5 * missing;
  }
  PointCloud points;
  points.positions.resize(3 * static_cast<std::size_t>(n));
  points.colors.assign(points.positions.size(), 128);
  const RandomKey key{0, RandomStream::kScenePoints, 0};
  for (std::size_t row = 0; row < static_cast<std::size_t>(n); ++row) {
    const std::array<float, 4> uniform = random_uniform(key, row);
    for (std::size_t axis = 0; axis < 3; ++axis) {
      points.positions[3 * row + axis] = static_cast<float>(low[axis] + uniform[axis] * (high[axis] - low[axis]));
    }
  }
  return points;
}

}  // namespace b3dgs
