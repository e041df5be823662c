// Predicts whether the files of a training will fit on the disk.
#pragma once

#include <cstdint>
#include <filesystem>
#include <string>

namespace b3dgs {

/// Bytes that this user can write to the file system of `folder`; -1 if unknown.
std::int64_t free_disk_bytes(const std::filesystem::path& folder);

/// Size of a PLY and of a checkpoint in bytes, without their headers.
std::int64_t ply_bytes(std::int64_t n_gaussians, int sh_degree);
std::int64_t checkpoint_bytes(std::int64_t n_gaussians, int sh_degree);

/// A warning of one line if `free_bytes` are too few for a PLY and `n_checkpoints` + 1 checkpoints of the Gaussians
/// that a training starts with (a new checkpoint is written before the oldest is removed); else "".
std::string disk_warning(const std::filesystem::path& folder, std::int64_t free_bytes, std::int64_t n_gaussians,
                         int sh_degree, int n_checkpoints);

}  // namespace b3dgs
