// Inside the reader of COLMAP models: one function for each file and format.
#pragma once

#include <map>
#include <vector>

#include "core/files/file_reader.h"
#include "scene/colmap/colmap.h"

namespace b3dgs::colmap {

// Each reads one file and checks its structure, but not its values. @throws InputError

std::map<std::uint32_t, ColmapCamera> read_cameras_binary(FileReader& file);
std::vector<ColmapImage> read_images_binary(FileReader& file);
std::vector<ColmapPoint> read_points_binary(FileReader& file, bool tracks);
std::uint64_t count_images_binary(FileReader& file);

std::map<std::uint32_t, ColmapCamera> read_cameras_text(FileReader& file);
std::vector<ColmapImage> read_images_text(FileReader& file);
std::vector<ColmapPoint> read_points_text(FileReader& file, bool tracks);

struct ModelFiles {
  FileReader &cameras, &images, &points;
};

/// Reads the three files and checks that their values are those of a valid model. @throws InputError
ColmapModel read_model(const ModelFiles& files, ColmapFormat format, bool tracks = false);

/// @throws InputError, beginning with `place`, if there is a camera with this id already
void add_camera(std::map<std::uint32_t, ColmapCamera>& cameras, ColmapCamera camera, const std::string& place);

}  // namespace b3dgs::colmap
