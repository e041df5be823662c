// The models that COLMAP's mapper has written.
#pragma once

#include <cstddef>
#include <cstdint>
#include <filesystem>

namespace b3dgs {

/// Moves the models in `from` to `to`/0, `to`/1, ..., the one with the most registered photographs first. Folders that
/// hold no readable model stay. @return the number of models
std::size_t order_models(const std::filesystem::path& from, const std::filesystem::path& to);

/// `path`, or with the first of ".2", ".3", ... that is not taken.
std::filesystem::path free_name(const std::filesystem::path& path);

}  // namespace b3dgs
