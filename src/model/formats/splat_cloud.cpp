#include "model/formats/splat_cloud.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>

namespace b3dgs {

std::vector<double> world_positions(const SplatCloud& cloud, std::size_t at_most) {
  const std::size_t step = 3 * std::max<std::size_t>(1, cloud.means.size() / 3 / at_most);
  std::vector<double> positions;
  for (std::size_t i = 0; i < cloud.means.size(); i += step) {
    const std::array<double, 3> position = cloud.frame.to_world(&cloud.means[i]);
    positions.insert(positions.end(), position.begin(), position.end());
  }
  return positions;
}

void change_frame(const CoordinateFrame& to, SplatCloud& cloud) {
  if (cloud.frame == to) return;
  for (std::size_t i = 0; i < cloud.means.size(); i += 3) {
    const std::array<double, 3> world = cloud.frame.to_world(&cloud.means[i]), local = to.from_world(world.data());
    for (std::size_t axis = 0; axis < 3; ++axis) cloud.means[i + axis] = static_cast<float>(local[axis]);
  }
  const double log_ratio = std::log(cloud.frame.unit / to.unit);
  for (float& scale : cloud.log_scales) scale = static_cast<float>(scale + log_ratio);
  cloud.frame = to;
}

}  // namespace b3dgs
