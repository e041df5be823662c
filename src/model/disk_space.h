// Predicts whether the files of a training will fit on the disk.
#pragma once

#include <cstdint>
#include <filesystem>
#include <string>

namespace b3dgs {

/// Bytes that this user can write to the file system of `folder`; -1 if unknown.
std::int64_t free_disk_bytes(const std::filesystem::path& folder);

/// Size of a PLY in bytes, without its header.
std::int64_t ply_bytes(std::int64_t n_gaussians, int sh_degree);

/// The files of the Gaussians that a training starts with.
struct FirstFiles {
  std::int64_t n_gaussians = 0;
  std::int64_t ply_bytes = 0, checkpoint_bytes = 0;  // of one file each
};

/// A warning of one line if `free_bytes` are too few for a PLY and `n_checkpoints` + 1 checkpoints (a new checkpoint is
/// written before the oldest is removed); else "".
std::string disk_warning(const std::filesystem::path& folder, std::int64_t free_bytes, const FirstFiles& files,
                         int n_checkpoints);

}  // namespace b3dgs
