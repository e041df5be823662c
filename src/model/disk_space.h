// Whether a training's files will fit on its disk.
#pragma once

#include <cstdint>
#include <filesystem>
#include <string>

namespace b3dgs {

/// Bytes that are free for this user where `folder` is; -1 where the system does not say.
std::int64_t free_disk_bytes(const std::filesystem::path& folder);

/// Bytes of a PLY, and of a checkpoint, of so many Gaussians.
std::int64_t ply_bytes(std::int64_t n_gaussians, int sh_degree);
std::int64_t checkpoint_bytes(std::int64_t n_gaussians, int sh_degree);

/// One line if the final PLY and `n_checkpoints` checkpoints (and the one that is written before an old one is removed)
/// of the number of Gaussians that a training starts with do not fit into free_bytes; else "".
std::string disk_warning(const std::filesystem::path& folder, std::int64_t free_bytes, std::int64_t n_gaussians,
                         int sh_degree, int n_checkpoints);

}  // namespace b3dgs
