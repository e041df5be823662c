#include "scene/images/image.h"

#include <algorithm>
#include <cstdlib>
#include <opencv2/core.hpp>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>

#include "core/check.h"
#include "core/files/atomic_file.h"
#include "core/files/file_reader.h"
#include "core/text.h"
#include "scene/images/tiff.h"

namespace b3dgs {
namespace {

namespace fs = std::filesystem;
using Bytes = std::vector<std::uint8_t>;

constexpr std::int64_t kMostPixels = std::int64_t{1} << 30;  // OpenCV decodes no larger images
// A small file can claim any size. The compression of PNG reaches 8256 pixels for a byte, with 1 bit per pixel. Only
// large masks of a single colour in WebP or TIFF exceed both limits.
constexpr std::int64_t kManyPixels = std::int64_t{1} << 26, kManyForAByte = 8300;

// The size is usually within these bytes, but a long EXIF segment can push it further back.
constexpr std::size_t kHeaderBytes = std::size_t{1} << 16;

Bytes read_bytes(FileReader& file, std::size_t at_most) {
  Bytes bytes(std::min<std::uint64_t>(file.remaining(), at_most));
  file.read_bytes(bytes.data(), bytes.size());
  return bytes;
}

void check_size(const fs::path& path, ImageSize size, std::uint64_t n_bytes, const char* what = "") {
  const std::int64_t most =
      std::min(kMostPixels, std::max(kManyPixels, kManyForAByte * static_cast<std::int64_t>(n_bytes)));
  if (std::int64_t{size.width} * size.height <= most) return;
  input_error(path.string(), ": expected at most ", most, " px in a file of ", n_bytes, " bytes, found ", what,
              size.width, " x ", size.height, "; reduce the image or remove it from the scene");
}

// OpenCV reads more formats, but not their sizes without decoding them.
ImageSize size_from_header(const fs::path& path, const Bytes& bytes) {
  if (const auto size = image_size_from_header(bytes)) return *size;
  input_error(path.string(), ": cannot be decoded: expected the header of a JPEG, PNG, BMP, TIFF, WebP or PNM image, ",
              "found other bytes; the file is damaged or of another format: convert it to PNG or JPEG, or remove it");
}

// Keeps the file's channels and depth, since the decoders' own conversions differ from those documented for
// read_image(). Alpha is not premultiplied, as in PNG.
cv::Mat decode(const fs::path& path, Bytes bytes) {
  const std::string damage = image_damage(bytes);
  if (!damage.empty()) input_error(path.string(), ": ", damage, "; copy the image again or remove it from the scene");
  check_size(path, size_from_header(path, bytes), bytes.size());
  if (const auto tiff = tiff_size(bytes)) check_size(path, tiff->part, bytes.size(), "a tile or strip of ");
  clear_tiff_orientation(bytes);
  cv::Mat image;
  std::string reason;
  try {
    std::optional<cv::Mat> with_alpha = decode_tiff_with_alpha(bytes);
    image = with_alpha ? *with_alpha : cv::imdecode(bytes, cv::IMREAD_UNCHANGED);  // also ignores the EXIF orientation
  } catch (const cv::Exception& error) {
    reason = error.err.empty() ? "" : " (" + error.err + ")";
  }
  if (image.empty()) {
    input_error(path.string(), ": cannot be decoded", reason,
                "; the file is damaged or of an unusual kind: convert it to PNG or JPEG, or remove it");
  }
  return image;
}

cv::Mat decode(const fs::path& path) {
  FileReader file(path);
  return decode(path, read_bytes(file, file.remaining()));
}

cv::Mat reduce_to_8_bits(const fs::path& path, const cv::Mat& image) {
  if (image.depth() == CV_8U) return image;
  if (image.depth() != CV_16U) {
    input_error(path.string(), ": expected 8 or 16 bits per channel, found another number format; convert it to PNG");
  }
  cv::Mat reduced;
  image.convertTo(reduced, CV_8U, 1.0 / 257.0);  // 65535 -> 255, rounded to nearest
  return reduced;
}

void composite(const cv::Mat& bgra, bool white_background, std::uint8_t* to) {
  const int background = white_background ? 255 : 0;
  for (int row = 0; row < bgra.rows; ++row) {
    const std::uint8_t* from = bgra.ptr<std::uint8_t>(row);
    for (int column = 0; column < bgra.cols; ++column, from += 4, to += 3) {
      const int alpha = from[3];
      for (int c = 0; c < 3; ++c) {
        to[c] = static_cast<std::uint8_t>((from[2 - c] * alpha + background * (255 - alpha) + 127) / 255);
      }
    }
  }
}

// Converts any decoded image to 8-bit RGB.
void convert(const fs::path& path, const cv::Mat& decoded, bool white_background, std::uint8_t* rgb) {
  const cv::Mat image = reduce_to_8_bits(path, decoded);
  if (image.channels() == 4) {
    composite(image, white_background, rgb);
    return;
  }
  if (image.channels() != 1 && image.channels() != 3) {
    input_error(path.string(), ": expected 1, 3 or 4 channels, found ", image.channels(), "; convert it to PNG");
  }
  cv::Mat to(image.rows, image.cols, CV_8UC3, rgb);
  cv::cvtColor(image, to, image.channels() == 1 ? cv::COLOR_GRAY2RGB : cv::COLOR_BGR2RGB);
}

/// Accepts one or three channels.
cv::Mat to_bgr(const Image8& image) {
  const cv::Mat from(image.height, image.width, CV_8UC(image.channels), const_cast<std::uint8_t*>(image.pixels.data()));
  if (image.channels == 1) return from;
  cv::Mat bgr;
  cv::cvtColor(from, bgr, cv::COLOR_RGB2BGR);
  return bgr;
}

void encode_to_file(const fs::path& path, const std::string& extension, const cv::Mat& image) {
  Bytes bytes;
  bool is_encoded = false;
  try {
    is_encoded = cv::imencode(extension, image, bytes, {cv::IMWRITE_JPEG_QUALITY, 95});
  } catch (const cv::Exception& error) {
    io_error(path.string(), ": cannot be encoded (", error.err, ")");
  }
  if (!is_encoded) io_error(path.string(), ": cannot be encoded as ", extension);
  AtomicFile file(path);
  file.write(bytes.data(), bytes.size());
  file.commit();
}

}  // namespace

Image8 read_image(const fs::path& path, bool white_background) {
  const cv::Mat decoded = decode(path);
  Image8 result(decoded.cols, decoded.rows, 3);
  convert(path, decoded, white_background, result.pixels.data());
  return result;
}

void read_image_into(const fs::path& path, bool white_background, ImageSize size, std::uint8_t* rgb) {
  const cv::Mat decoded = decode(path);
  if (ImageSize{decoded.cols, decoded.rows} != size) {
    input_error(path.string(), ": expected ", size.width, " x ", size.height,
                " px (its size when the scene was loaded), ", "found ", decoded.cols, " x ", decoded.rows,
                "; the file is damaged or was replaced");
  }
  convert(path, decoded, white_background, rgb);
}

std::optional<Image8> read_alpha(const fs::path& path) {
  const cv::Mat image = reduce_to_8_bits(path, decode(path));
  if (image.channels() != 4) return std::nullopt;
  Image8 alpha(image.cols, image.rows, 1);
  cv::Mat to(image.rows, image.cols, CV_8UC1, alpha.pixels.data());
  cv::extractChannel(image, to, 3);
  return alpha;
}

ImageSize read_image_size(const fs::path& path) {
  FileReader file(path);
  const std::uint64_t n_bytes = file.remaining();
  Bytes bytes = read_bytes(file, kHeaderBytes);
  std::optional<ImageSize> size = image_size_from_header(bytes);
  if (!size) {
    const Bytes more = read_bytes(file, file.remaining());
    bytes.insert(bytes.end(), more.begin(), more.end());
    size = size_from_header(path, bytes);
  }
  check_size(path, *size, n_bytes);
  return *size;
}

int read_orientation(const fs::path& path) {
  FileReader file(path);
  return exif_orientation(read_bytes(file, file.remaining()));
}

template <class Value>
void resize_into(const Raster<Value>& image, ImageSize size, Value* pixels) {
  B3DGS_CHECK(size.width > 0 && size.height > 0 && image.width > 0 && image.height > 0, "sizes must be positive");
  const int type = CV_MAKETYPE(cv::DataType<Value>::depth, image.channels);
  const cv::Mat from(image.height, image.width, type, const_cast<Value*>(image.pixels.data()));  // OpenCV only reads it
  cv::Mat to(size.height, size.width, type, pixels);
  if (size == image.size()) {
    from.copyTo(to);
    return;
  }
  const bool is_smaller = size.width <= image.width && size.height <= image.height;
  cv::resize(from, to, to.size(), 0, 0, is_smaller ? cv::INTER_AREA : cv::INTER_LINEAR);
}
template void resize_into(const Image8&, ImageSize, std::uint8_t*);
template void resize_into(const Depth16&, ImageSize, std::uint16_t*);

Depth16 read_depth_map(const fs::path& path) {
  const cv::Mat decoded = decode(path);
  if (decoded.depth() != CV_16U || decoded.channels() != 1) {
    const int bits = static_cast<int>(8 * decoded.elemSize1());
    input_error(path.string(), ": expected a depth map of one channel with 16 bits, found ", decoded.channels(),
                decoded.channels() == 1 ? " channel" : " channels", " with ", bits,
                " bits; write inverse depth as a 16-bit grey PNG");
  }
  Depth16 map(decoded.cols, decoded.rows);
  decoded.copyTo(cv::Mat(map.height, map.width, CV_16UC1, map.pixels.data()));
  return map;
}

void write_depth_map(const fs::path& path, const Depth16& map) {
  B3DGS_CHECK(map.width > 0 && map.height > 0, "an empty map");
  encode_to_file(path, ".png", {map.height, map.width, CV_16UC1, const_cast<std::uint16_t*>(map.pixels.data())});
}

void write_exr(const fs::path& path, ImageSize size, const float* values) {
  B3DGS_CHECK(size.width > 0 && size.height > 0, "an empty image");
  // Newer versions of OpenCV write OpenEXR only if this is set before the first attempt.
  ::setenv("OPENCV_IO_ENABLE_OPENEXR", "1", /*overwrite=*/0);
  if (!cv::haveImageWriter("image.exr")) {
    input_error(path.string(), ": the installed OpenCV cannot write OpenEXR; use 16-bit PNG");
  }
  encode_to_file(path, ".exr", {size.height, size.width, CV_32FC1, const_cast<float*>(values)});
}

void write_image(const fs::path& path, const Image8& image) {
  B3DGS_CHECK(image.channels == 1 || image.channels == 3, "an image of ", image.channels, " channels");
  B3DGS_CHECK(image.width > 0 && image.height > 0, "an empty image");
  const std::string extension = lower_case(path.extension().string());
  if (extension != ".png" && extension != ".jpg" && extension != ".jpeg") {
    input_error(path.string(), ": expected a file name that ends in .png, .jpg or .jpeg");
  }
  encode_to_file(path, extension, to_bgr(image));
}

std::string encode_jpeg(const Image8& image, int quality) {
  Bytes bytes;
  if (!cv::imencode(".jpg", to_bgr(image), bytes, {cv::IMWRITE_JPEG_QUALITY, quality})) {
    io_error("an image of ", image.width, " x ", image.height, " px cannot be encoded as JPEG");
  }
  return {bytes.begin(), bytes.end()};
}

}  // namespace b3dgs
