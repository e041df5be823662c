// PLY files of plain points.
#pragma once

#include <filesystem>

#include "core/files/file_reader.h"
#include "core/files/ply_reader.h"
#include "scene/points/point_cloud.h"

namespace b3dgs {

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
