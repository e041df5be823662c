// The region of --crop: which part of a scene to keep.
#pragma once

#include <array>
#include <string>

namespace b3dgs {

/// An axis-aligned box, or a sphere; world units.
struct CropRegion {
  std::array<double, 3> low{}, high{};  // of a box
  std::array<double, 3> center{};       // of a sphere
  double radius = 0;                    // 0: a box

  bool contains(const std::array<double, 3>& position) const;
};

/// Parses a region: "x0,y0,z0,x1,y1,z1" is a box between two opposite corners, "x,y,z,radius" a sphere. @throws
/// InputError for other texts, and for a region without volume
CropRegion parse_crop(const std::string& text);

}  // namespace b3dgs
