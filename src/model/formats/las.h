// Point clouds in LAS files, which programs for maps and surveying open.
#pragma once

#include <filesystem>

#include "model/formats/splat_formats.h"

namespace b3dgs {

/// Returns whether the extension is .las, in upper or lower case.
bool is_las(const std::filesystem::path& path);

/// Writes the centres of the Gaussians with their colour as seen from the mean direction, and their opacity as
/// intensity: ASPRS LAS 1.2, point format 2, in steps of 1 mm, or more if the points spread over 2000 km. `epsg` is the
/// code of the projected coordinate system of the world coordinates, or 0. The write is atomic. @throws IoError
void write_las(const std::filesystem::path& path, const SplatCloud& cloud, int epsg);

}  // namespace b3dgs
