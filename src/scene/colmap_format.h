// What the two formats of a COLMAP model have in common inside the reader: one function per file.
#pragma once

#include <filesystem>
#include <map>
#include <vector>

#include "scene/colmap.h"

namespace b3dgs::colmap {

// Each reads one file, checks its structure and leaves the values to the caller. @throws InputError

std::map<std::uint32_t, ColmapCamera> read_cameras_binary(const std::filesystem::path& file);
std::vector<ColmapImage> read_images_binary(const std::filesystem::path& file);
std::vector<ColmapPoint> read_points_binary(const std::filesystem::path& file);
std::uint64_t count_images_binary(const std::filesystem::path& file);

std::map<std::uint32_t, ColmapCamera> read_cameras_text(const std::filesystem::path& file);
std::vector<ColmapImage> read_images_text(const std::filesystem::path& file);
std::vector<ColmapPoint> read_points_text(const std::filesystem::path& file);

/// Adds a camera. @throws InputError, beginning with `place`, if its id is taken.
void add_camera(std::map<std::uint32_t, ColmapCamera>& cameras, ColmapCamera camera, const std::string& place);

}  // namespace b3dgs::colmap
