// Images in memory and in files.
#pragma once

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>
#include <vector>

namespace b3dgs {

struct ImageSize {
  int width = 0, height = 0;  // px

  bool operator==(const ImageSize& other) const { return width == other.width && height == other.height; }
  bool operator!=(const ImageSize& other) const { return !(*this == other); }
};

/// A row-major, interleaved image.
template <class Value>
struct Raster {
  int width = 0, height = 0, channels = 1;
  std::vector<Value> pixels;  // [height, width, channels]

  Raster() = default;
  Raster(int w, int h, int c = 1) : width(w), height(h), channels(c), pixels(static_cast<std::size_t>(w) * h * c) {}

  ImageSize size() const { return {width, height}; }
  /// Returns the channels of a pixel.
  Value* at(int x, int y) { return pixels.data() + (static_cast<std::size_t>(y) * width + x) * channels; }
  const Value* at(int x, int y) const { return const_cast<Raster*>(this)->at(x, y); }
};
using Image8 = Raster<std::uint8_t>;    // three channels are RGB
using Depth16 = Raster<std::uint16_t>;  // an inverse depth map, up to scale and offset

// The size that a photograph is trained at (the rules for -r and for a missing images_N folder), and aspect ratios.

inline constexpr int kMaxDefaultWidth = 1600;  // px; largest width for -r -1
inline constexpr int kMinWidth = 32;           // px; smallest width that -r accepts

/// Returns the size of the images in an images_N folder: each side is divided by N and rounded to nearest, halves up.
ImageSize divided_size(ImageSize size, int divisor);

/// Returns the size for a value of -r. 1, 2, 4 and 8 divide each side, rounding to nearest, halves to even, as Python
/// does. -1 limits the width to kMaxDefaultWidth. Other values are the target width, with the height rounded down. The
/// result is never larger than `size` and never smaller than 1 px.
ImageSize training_size(ImageSize size, int resolution);

/// @throws InputError unless `resolution` is -1, 1, 2, 4, 8 or at least kMinWidth, because -r 3 is probably meant as a
/// divisor
void check_resolution(int resolution);

/// Returns whether the aspect ratios are equal, up to the rounding of one side by a pixel of the smaller image.
bool has_same_aspect(ImageSize other, ImageSize size);
/// Returns whether they are equal only if the sides of `other` are swapped.
bool is_turned(ImageSize other, ImageSize size);

// Size of image files, and completeness of JPEG and PNG files, without decoding them. OpenCV decodes the whole image to
// return its size, and fills the missing part of a truncated JPEG with grey. Also the EXIF orientation of JPEG files,
// with which a camera that was held upright marks that its image lies on its side.

/// Returns the size from the first bytes of a JPEG, PNG, BMP, TIFF, WebP or PNM (PBM, PGM, PPM) file. Returns nothing
/// for other formats, or if the size comes later in the file.
std::optional<ImageSize> image_size_from_header(const std::vector<std::uint8_t>& beginning);

/// Returns why the bytes of a file are not a complete JPEG or PNG ("the PNG ends before ..."). Returns "" if they seem
/// complete or have another format.
std::string image_damage(const std::vector<std::uint8_t>& file);

/// Returns the EXIF orientation in the bytes of a JPEG, PNG, WebP or TIFF file, 1 to 8, or 1 (upright) if there is
/// none. The first 128 KiB of a JPEG are enough.
int exif_orientation(const std::vector<std::uint8_t>& bytes);
/// Returns the orientation of a JPEG file, or 1 for other files and those that cannot be read.
int read_exif_orientation(const std::filesystem::path& path);

/// Turns an image upright that is stored in the given EXIF orientation, 1 to 8.
template <class Value>  // of Image8 or Depth16
Raster<Value> turn_upright(const Raster<Value>& stored, int orientation);

/// Marks a TIFF as upright, because otherwise OpenCV turns it. Does nothing to other files.
void clear_tiff_orientation(std::vector<std::uint8_t>& bytes);

/// Returns a JPEG file turned upright and encoded again with quality 98. Keeps the other EXIF data, from which COLMAP
/// takes the focal length, and the colour profile. Returns nothing if the file cannot be decoded.
std::optional<std::vector<std::uint8_t>> turned_upright(const std::vector<std::uint8_t>& jpeg);

// Reads and writes image files with OpenCV. Images are RGB here, not BGR as in OpenCV.

/// Reads the formats of image_size_from_header() as 8-bit RGB. Grey is copied to all channels, 16 bits are reduced to
/// 8, and alpha is composited on white or black. The EXIF orientation is ignored, as in COLMAP. @throws InputError with
/// the file's name if it is missing or damaged, or claims a size that would take far more memory than the file
/// justifies
Image8 read_image(const std::filesystem::path& path, bool white_background);

/// Does the same, but writes to 3 x width x height bytes. `size` is that of read_image_size(). @throws InputError also
/// if the file's size has changed
void read_image_into(const std::filesystem::path& path, bool white_background, ImageSize size, std::uint8_t* rgb);

/// Returns the alpha channel in 8 bits, or nothing if the image has none. @throws InputError as read_image()
std::optional<Image8> read_alpha(const std::filesystem::path& path);

/// Returns the size of an image file from its header. @throws InputError as read_image()
ImageSize read_image_size(const std::filesystem::path& path);

/// Reads the EXIF orientation of a JPEG, PNG, WebP or TIFF file (exif_orientation()). @throws InputError
int read_orientation(const std::filesystem::path& path);

/// Averages areas when shrinking, interpolates bilinearly when enlarging. `pixels`: size.width x size.height x
/// image.channels values.
template <class Value>  // of Image8 or Depth16
void resize_into(const Raster<Value>& image, ImageSize size, Value* pixels);
template <class Value>
Raster<Value> resize_image(const Raster<Value>& image, int width, int height) {
  Raster<Value> result(width, height, image.channels);
  resize_into(image, {width, height}, result.pixels.data());
  return result;
}

/// Reads a grey image of 16 bits. @throws InputError with the file's name if it is missing, damaged or in another
/// format
Depth16 read_depth_map(const std::filesystem::path& path);

/// Writes a grey PNG of 16 bits atomically. @throws IoError
void write_depth_map(const std::filesystem::path& path, const Depth16& map);

/// Writes an OpenEXR file with one channel of 32-bit floats, "Y". `values` [height, width]. The write is atomic.
/// @throws InputError if the installed OpenCV cannot write OpenEXR; IoError
void write_exr(const std::filesystem::path& path, ImageSize size, const float* values);

/// Writes PNG or JPEG by extension, with one or three channels, atomically. @throws InputError for other extensions;
/// IoError
void write_image(const std::filesystem::path& path, const Image8& image);

/// Encodes a JPEG with one or three channels. Quality ranges from 1 to 100. @throws IoError if it cannot be encoded
std::string encode_jpeg(const Image8& image, int quality);

}  // namespace b3dgs
