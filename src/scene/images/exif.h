// The EXIF orientation of JPEG files, by which a camera that was held upright says that its image lies on its side.
#pragma once

#include <cstdint>
#include <filesystem>
#include <optional>
#include <vector>

namespace b3dgs {

/// The orientation that the first bytes of a JPEG file give, 1 to 8; 1 is upright, and what is taken if there is none.
int exif_orientation(const std::vector<std::uint8_t>& beginning);

/// The same for a file; 1 if it is not a JPEG file that can be read.
int read_exif_orientation(const std::filesystem::path& path);

/// A JPEG file turned upright and encoded again with quality 98. Keeps the other EXIF data, from which COLMAP takes the
/// focal length, and the colour profile. Nothing if the file cannot be decoded.
std::optional<std::vector<std::uint8_t>> turned_upright(const std::vector<std::uint8_t>& jpeg);

}  // namespace b3dgs
