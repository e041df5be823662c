// Image files through OpenCV. RGB at this border; OpenCV's BGR stays inside.
#pragma once

#include <filesystem>

#include "scene/image.h"

namespace b3dgs {

/// Reads JPEG, PNG, PNM... as 8-bit RGB. Grey is repeated, 16 bits are reduced to 8, alpha is composited on white or
/// black; EXIF orientation is ignored, as COLMAP does. @throws InputError naming the file if it is missing or corrupt.
Image8 read_image(const std::filesystem::path& path, bool white_background);

/// Width and height (px) of an image file. @throws InputError
struct ImageSize {
  int width = 0, height = 0;
};
ImageSize read_image_size(const std::filesystem::path& path);

/// Area-averaging when shrinking, bilinear when enlarging.
Image8 resize_image(const Image8& image, int width, int height);

/// Writes PNG or JPEG by extension; one or three channels; the file appears whole or not at all. @throws IoError
void write_image(const std::filesystem::path& path, const Image8& image);

}  // namespace b3dgs
