// What the two formats of a COLMAP model have in common inside the reader: one function per file.
#pragma once

#include <map>
#include <vector>

#include "core/files/file_reader.h"
#include "scene/colmap/colmap.h"

namespace b3dgs::colmap {

// Each reads one file, checks its structure and leaves the values to the caller. @throws InputError

std::map<std::uint32_t, ColmapCamera> read_cameras_binary(FileReader& file);
std::vector<ColmapImage> read_images_binary(FileReader& file);
std::vector<ColmapPoint> read_points_binary(FileReader& file);
std::uint64_t count_images_binary(FileReader& file);

std::map<std::uint32_t, ColmapCamera> read_cameras_text(FileReader& file);
std::vector<ColmapImage> read_images_text(FileReader& file);
std::vector<ColmapPoint> read_points_text(FileReader& file);

struct ModelFiles {
  FileReader &cameras, &images, &points;
};

/// Reads the three files and checks that their values make a model: what this returns can be used. @throws InputError
ColmapModel read_model(const ModelFiles& files, ColmapFormat format);

/// Adds a camera. @throws InputError, beginning with `place`, if its id is taken.
void add_camera(std::map<std::uint32_t, ColmapCamera>& cameras, ColmapCamera camera, const std::string& place);

}  // namespace b3dgs::colmap
