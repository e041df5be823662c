// The file formats of Gaussians as a table. Whatever reads or writes a file that the user named goes through here, so a
// new format is one file with its reader and writer, and one row in splat_formats.cpp.
#pragma once

#include <filesystem>
#include <vector>

#include "model/formats/splat_cloud.h"

namespace b3dgs {

struct SplatFormat {
  const char* name;       // in messages
  const char* extension;  // lower case, with the dot

  /// @throws InputError if the file is missing or damaged, or a Gaussian has values that are not finite or a quaternion
  /// of length 0
  SplatCloud (*read)(const std::filesystem::path& path);
  /// The file appears complete or not at all. @throws IoError
  void (*write)(const std::filesystem::path& path, const SplatCloud& cloud);
  /// Whether a file of this format holds Gaussians; null: always. (A PLY may hold plain points.) @throws InputError
  bool (*holds_splats)(const std::filesystem::path& path);
};

/// All formats; the first is PLY.
const std::vector<SplatFormat>& splat_formats();

/// The format that the extension of `path` stands for, in upper or lower case; null: none.
const SplatFormat* find_splat_format(const std::filesystem::path& path);

/// Reads Gaussians in the format of the file's extension. Files with other extensions are read as PLY. @throws
/// InputError
SplatCloud read_splats(const std::filesystem::path& path);

/// Whether read_splats() applies, rather than read_point_ply(). @throws InputError
bool holds_splats(const std::filesystem::path& path);

/// Writes Gaussians in the format of the file's extension. @throws InputError if no format has it; IoError
void write_splats(const std::filesystem::path& path, const SplatCloud& cloud);

}  // namespace b3dgs
