// What the first and last bytes of JPEG and PNG files say: size, and whether the file is whole. Decoders give neither
// cheaply: they decode everything for the size, and fill the missing part of a truncated JPEG with grey.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "scene/images/image_io.h"

namespace b3dgs {

/// Size from the beginning of a JPEG or PNG file; nothing if it is another format or the size lies further on.
std::optional<ImageSize> image_size_from_header(const std::vector<std::uint8_t>& beginning);

/// Why a whole file cannot be a complete JPEG or PNG ("ends in the middle of ..."), or "" if it may be one or is
/// another format.
std::string image_damage(const std::vector<std::uint8_t>& file);

}  // namespace b3dgs
