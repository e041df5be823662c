// PLY files of plain points.
#pragma once

#include <filesystem>

#include "core/files/file_reader.h"
#include "core/files/ply_reader.h"
#include "scene/point_cloud.h"

namespace b3dgs {

/// Writes x y z as float, red green blue as uchar. @throws IoError
void write_point_ply(const std::filesystem::path& path, const PointCloud& points);

/// Reads x, y, z and colours by name, in any order and of any scalar type, from binary (both byte orders) or ASCII
/// files. Colours of type float and double range from 0 to 1, 16-bit colours are reduced to 8 bits, and points without
/// colours become mid-grey. @throws InputError, also for values that are not finite
PointCloud read_point_ply(const std::filesystem::path& path);
PointCloud read_point_ply(FileReader& file);

/// @throws InputError for SuperSplat's compressed PLY and models of 2D Gaussian Splatting, whose columns differ
void refuse_other_ply(const PlyReader& reader);

}  // namespace b3dgs
