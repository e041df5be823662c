// Detects photographs that have changed since a model was trained on them.
#pragma once

#include <filesystem>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "scene/scene.h"

namespace b3dgs {

/// {"bytes", "crc32", "rest_crc32"}: the size of a photograph, the CRC-32 of its first 64 KiB, and that of the rest; of
/// the rest of a JPEG, PNG or WebP file only the last 64 KiB. An edit of a compressed image changes the size or all
/// that follows; in a file without compression it may change a few bytes anywhere. Null if the file cannot be read.
nlohmann::ordered_json photograph_fingerprint(const std::string& path);

/// Whether the fingerprints are of the same file. `before` may be of an early version, which had no "rest_crc32".
bool is_same_photograph(const nlohmann::ordered_json& before, const nlohmann::ordered_json& now);

/// An object from the names of all views to the fingerprints of their photographs.
nlohmann::ordered_json photograph_fingerprints(const Scene& scene);

/// Names of views whose photographs have other fingerprints than in `file` (photographs.json of the model folder).
/// Empty if that file is missing or damaged, as in models of early versions.
std::vector<std::string> changed_views(const std::filesystem::path& file, const std::vector<View>& views);

}  // namespace b3dgs
