// Image files through OpenCV. RGB at this border; OpenCV's BGR stays inside.
#pragma once

#include <cstdint>
#include <filesystem>

#include "scene/images/image.h"

namespace b3dgs {

/// Reads JPEG, PNG, PNM... as 8-bit RGB. Grey is repeated, 16 bits are reduced to 8, alpha is composited on white or
/// black; EXIF orientation is ignored, as COLMAP does. @throws InputError naming the file if it is missing or corrupt.
Image8 read_image(const std::filesystem::path& path, bool white_background);

struct ImageSize {
  int width = 0, height = 0;  // px
};

/// The same, written to the 3 x width x height bytes of an image whose size is known from read_image_size().
/// @throws InputError also if the file has another size now
void read_image_into(const std::filesystem::path& path, bool white_background, ImageSize size, std::uint8_t* rgb);

/// Width and height of an image file. @throws InputError
ImageSize read_image_size(const std::filesystem::path& path);

/// Area-averaging when shrinking, bilinear when enlarging.
Image8 resize_image(const Image8& image, int width, int height);
/// The same, written to size.width x size.height x image.channels bytes.
void resize_image_into(const Image8& image, ImageSize size, std::uint8_t* pixels);

/// Writes PNG or JPEG by extension; one or three channels; the file appears whole or not at all. @throws IoError
void write_image(const std::filesystem::path& path, const Image8& image);

}  // namespace b3dgs
