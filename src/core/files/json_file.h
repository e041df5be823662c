// Reads JSON files.
#pragma once

#include <filesystem>
#include <nlohmann/json.hpp>
#include <string>

namespace b3dgs {

/// Reads a JSON file. Returns null if there is no file, and a discarded value (is_discarded()) if it is not valid JSON.
/// @throws InputError if it cannot be read, or an object in it has the same key twice
nlohmann::ordered_json read_json(const std::filesystem::path& path, bool ignore_comments = false);

/// Returns the path of the file `name` in `folder`, where the name comes from a JSON file. `place` is where the name is
/// used, for errors. @throws InputError if it is not a plain file name, or a link leads out of the folder
std::filesystem::path file_in(const std::filesystem::path& folder, const std::string& name, const std::string& place);

}  // namespace b3dgs
