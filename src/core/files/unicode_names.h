// File names in Unicode. A letter such as U+00FC can also be written as u and a combining mark. macOS writes such
// names, other systems do not, and Linux treats the two as different names.
#pragma once

#include <filesystem>
#include <string>

namespace b3dgs {

/// Returns the name with composed letters (NFC), or unchanged if it is not valid UTF-8.
std::string composed_name(const std::string& name);

/// Returns the file `name` of the folder, which may be stored with composed or decomposed letters, or empty if it does
/// not exist.
std::filesystem::path find_in_any_form(const std::filesystem::path& folder, const std::string& name);

}  // namespace b3dgs
