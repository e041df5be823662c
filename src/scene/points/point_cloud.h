// Points with colours, from structure from motion or LiDAR, and their PLY files.
#pragma once

#include <cstdint>
#include <filesystem>
#include <vector>

#include "scene/cameras/coordinate_frame.h"

namespace b3dgs {

class FileReader;
class PlyReader;

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

/// Writes x y z as float, or as double if `frame`, that of the points, is far from the world's origin; red green blue
/// as uchar. @throws IoError
void write_point_ply(const std::filesystem::path& path, const PointCloud& points, const CoordinateFrame& frame = {});

/// Reads x, y, z and colours by name, in any order and of any scalar type, from binary (both byte orders) or ASCII
/// files. Colours of type float and double range from 0 to 1, 16-bit colours are reduced to 8 bits, and points without
/// colours become mid-grey. @throws InputError, also for values that are not finite
WorldPoints read_point_ply(const std::filesystem::path& path);
WorldPoints read_point_ply(FileReader& file);

/// @throws InputError for SuperSplat's compressed PLY and models of 2D Gaussian Splatting, whose columns differ
void refuse_other_ply(const PlyReader& reader);

}  // namespace b3dgs
