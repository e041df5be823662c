// Points with colours, from structure from motion or LiDAR.
#pragma once

#include <cstdint>
#include <vector>

namespace b3dgs {

struct PointCloud {
  std::vector<float> positions;      // [N, 3] world
  std::vector<std::uint8_t> colors;  // [N, 3] RGB

  std::int64_t size() const { return static_cast<std::int64_t>(positions.size() / 3); }
};

}  // namespace b3dgs
