// Maps local coordinates in single precision to those of the world.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>

namespace b3dgs {

/// world = origin + unit * local. A scene is trained in a frame of its own (scene/cameras/scene_frame.h), so that
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

}  // namespace b3dgs
