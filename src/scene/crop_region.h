// The region of --crop: which part of a scene to keep.
#pragma once

#include <array>
#include <string>

#include "scene/cameras/coordinate_frame.h"

namespace b3dgs {

/// An axis-aligned box, or a sphere; world units.
struct CropRegion {
  std::array<double, 3> low{}, high{};  // of a box
  std::array<double, 3> center{};       // of a sphere
  double radius = 0;                    // 0: a box

  bool contains(const std::array<double, 3>& position) const;
};

/// Parses a region: "x0,y0,z0,x1,y1,z1" is a box between two opposite corners, "x,y,z,radius" a sphere. Any other text
/// is the name of a file whose only line, besides blank lines and those that begin with #, is a region. @throws
/// InputError for a text or file that is none, and for a region without volume
CropRegion parse_crop(const std::string& text);

/// Returns the text of numbers from which parse_crop() makes the same region.
std::string crop_text(const CropRegion& region);

/// Returns a region of the world in the coordinates of `frame`.
CropRegion in_frame(const CoordinateFrame& frame, CropRegion region);

}  // namespace b3dgs
