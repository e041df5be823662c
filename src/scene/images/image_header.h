// Size and completeness of JPEG and PNG files, without decoding them. OpenCV decodes the whole image to tell its size,
// and fills the missing part of a truncated JPEG with grey.
#pragma once

#include <cstdint>
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

}  // namespace b3dgs
