// report.html: a single file without external resources. The program writes the data; page/ draws it.
#pragma once

#include <string>

#include <nlohmann/json.hpp>

#include "scene/images/image.h"

namespace b3dgs {

/// The page that shows `data`, with "kind" training or comparison. Any text in `data` is safe, also broken UTF-8 and
/// HTML; fractions are rounded to 6 digits.
std::string report_page(nlohmann::ordered_json data);

/// The image as JPEG in a data URI. @throws IoError if it cannot be encoded
std::string data_uri(const Image8& rgb);

}  // namespace b3dgs
