// Inside the reader and writer of COLMAP models: the records of their files.
#pragma once

#include <cstdint>
#include <filesystem>

#include "scene/colmap/colmap.h"

namespace b3dgs::colmap {

/// "FOLDER/images.bin" for the stem "images".
std::filesystem::path file_of(const std::filesystem::path& folder, const char* stem, ColmapFormat format);

/// Reads the files and checks their structure, and that no camera is there twice, but not values. @throws InputError
ColmapModel read_unchecked(const ColmapFiles& files, ColmapFormat format, bool tracks);

/// Number of images in an images file. @throws InputError
std::uint64_t count_images(FileReader& file, ColmapFormat format);

}  // namespace b3dgs::colmap
