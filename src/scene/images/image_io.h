// Reads and writes image files with OpenCV. Images are RGB here; only image_io.cpp sees OpenCV's BGR.
#pragma once

#include <cstdint>
#include <filesystem>
#include <optional>

#include "scene/images/image.h"

namespace b3dgs {

/// Reads JPEG, PNG, PNM and other formats as 8-bit RGB. Grey is copied to all channels, 16 bits are reduced to 8, alpha
/// is composited on white or black; the EXIF orientation is ignored, as COLMAP does. @throws InputError with the file's
/// name if it is missing or damaged
Image8 read_image(const std::filesystem::path& path, bool white_background);

/// The same, written to 3 x width x height bytes; `size` is that of read_image_size(). @throws InputError also if the
/// file's size has changed
void read_image_into(const std::filesystem::path& path, bool white_background, ImageSize size, std::uint8_t* rgb);

/// The alpha channel, 8 bits; nothing if the image has none. @throws InputError as read_image()
std::optional<Image8> read_alpha(const std::filesystem::path& path);

/// Width and height of an image file, from its header where possible. @throws InputError
ImageSize read_image_size(const std::filesystem::path& path);

/// Averages areas when shrinking, interpolates bilinearly when enlarging.
Image8 resize_image(const Image8& image, int width, int height);
/// The same, written to size.width x size.height x image.channels bytes.
void resize_image_into(const Image8& image, ImageSize size, std::uint8_t* pixels);

/// Reads a grey image of 16 bits. @throws InputError with the file's name if it is missing, damaged or something else
Depth16 read_depth_map(const std::filesystem::path& path);
/// Averages areas when shrinking, interpolates bilinearly when enlarging.
Depth16 resize_depth_map(const Depth16& map, ImageSize size);

/// Writes a grey PNG of 16 bits. The file appears complete or not at all. @throws IoError
void write_depth_map(const std::filesystem::path& path, const Depth16& map);

/// Writes an OpenEXR file with one channel of 32-bit floats, "Y". `values` [height, width]. The file appears complete
/// or not at all. @throws InputError if the installed OpenCV cannot write OpenEXR; IoError
void write_exr(const std::filesystem::path& path, ImageSize size, const float* values);

/// Writes PNG or JPEG by extension, with one or three channels. The file appears complete or not at all.
/// @throws InputError for other extensions; IoError
void write_image(const std::filesystem::path& path, const Image8& image);

}  // namespace b3dgs
