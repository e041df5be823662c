// Size and completeness of JPEG and PNG files, without decoding them: OpenCV decodes the whole image to tell its size,
// and fills the missing part of a truncated JPEG with grey. And the EXIF orientation of JPEG files, by which a camera
// that was held upright says that its image lies on its side.
#pragma once

#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "scene/images/image.h"

namespace b3dgs {

/// Size from the first bytes of a JPEG or PNG file; nothing for other formats, or if the size comes later in the file.
std::optional<ImageSize> image_size_from_header(const std::vector<std::uint8_t>& beginning);

/// Why the bytes of a file are not a complete JPEG or PNG ("the PNG ends before ..."); "" if they seem complete or are
/// of another format.
std::string image_damage(const std::vector<std::uint8_t>& file);

/// The orientation that the first bytes of a JPEG file give, 1 to 8; 1 is upright, and what is taken if there is none.
int exif_orientation(const std::vector<std::uint8_t>& beginning);

/// The same for a file; 1 if it is not a JPEG file that can be read.
int read_exif_orientation(const std::filesystem::path& path);

/// A JPEG file turned upright and encoded again with quality 98. Keeps the other EXIF data, from which COLMAP takes the
/// focal length, and the colour profile. Nothing if the file cannot be decoded.
std::optional<std::vector<std::uint8_t>> turned_upright(const std::vector<std::uint8_t>& jpeg);

}  // namespace b3dgs
