// Reading of JSON files.
#pragma once

#include <filesystem>
#include <nlohmann/json.hpp>
#include <string>

namespace b3dgs {

/// Reads a JSON file. Returns null if there is no file, and a discarded value (is_discarded()) if it is not valid JSON.
/// @throws InputError if it cannot be read, or an object in it has the same key twice
nlohmann::ordered_json read_json(const std::filesystem::path& path, bool ignore_comments = false);

}  // namespace b3dgs
