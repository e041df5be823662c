// Detects photographs that have changed since a model was trained on them.
#pragma once

#include <filesystem>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "scene/scene.h"

namespace b3dgs {

/// {"bytes", "crc32"}: the size of a photograph and the CRC-32 of its first 64 KiB; null if it cannot be read.
nlohmann::ordered_json photograph_fingerprint(const std::string& path);

/// An object from the names of all views to the fingerprints of their photographs.
nlohmann::ordered_json photograph_fingerprints(const Scene& scene);

/// Names of views whose photographs have other fingerprints than in `file` (photographs.json of the model folder).
/// Empty if that file is missing or damaged, as in models of early versions.
std::vector<std::string> changed_views(const std::filesystem::path& file, const std::vector<View>& views);

}  // namespace b3dgs
