#include "scene/images/image.h"

#include <algorithm>
#include <array>
#include <cctype>
#include <cmath>
#include <cstdlib>
#include <cstring>
#include <limits>
#include <opencv2/core.hpp>
#include <opencv2/imgcodecs.hpp>
#include <string_view>

#include "core/check.h"
#include "core/files/file_reader.h"
#include "scene/images/tiff.h"

namespace b3dgs {
namespace {

using Bytes = std::vector<std::uint8_t>;

constexpr std::array<std::uint8_t, 8> kPngSignature{0x89, 'P', 'N', 'G', '\r', '\n', 0x1a, '\n'};

std::uint64_t value_at(const Bytes& bytes, std::size_t at, std::size_t count, bool is_little_endian = false) {
  std::uint64_t value = 0;
  for (std::size_t i = 0; i < count; ++i) value = value << 8 | bytes[is_little_endian ? at + count - 1 - i : at + i];
  return value;
}

bool has_text(const Bytes& bytes, std::size_t at, std::string_view text) {
  return at <= bytes.size() && bytes.size() - at >= text.size() &&
         std::memcmp(bytes.data() + at, text.data(), text.size()) == 0;
}

bool is_webp(const Bytes& bytes) {
  return has_text(bytes, 0, "RIFF") && has_text(bytes, 8, "WEBP");
}

bool is_png(const Bytes& bytes) {
  return bytes.size() >= kPngSignature.size() && std::equal(kPngSignature.begin(), kPngSignature.end(), bytes.begin());
}

bool is_jpeg(const Bytes& bytes) {
  return bytes.size() >= 3 && bytes[0] == 0xff && bytes[1] == 0xd8 && bytes[2] == 0xff;
}

// Second bytes of JPEG markers, after 0xff (ITU-T T.81, table B.1).
constexpr std::uint8_t kTemporary = 0x01, kEndOfImage = 0xd9, kStartOfScan = 0xda, kApp0 = 0xe0, kApp1 = 0xe1,
                       kApp2 = 0xe2;
bool is_restart(std::uint8_t marker) {
  return marker >= 0xd0 && marker <= 0xd7;
}
bool is_start_of_frame(std::uint8_t marker) {
  return marker >= 0xc0 && marker <= 0xcf && marker != 0xc4 && marker != 0xc8 && marker != 0xcc;  // DHT, JPG, DAC
}

struct Segment {
  std::uint8_t marker = 0;
  std::size_t begin = 0, end = 0;  // starting at the marker's 0xff
};

/// Returns the complete segments of a JPEG. The last one is kEndOfImage if the file is complete.
std::vector<Segment> segments_of(const Bytes& bytes) {
  std::vector<Segment> segments;
  for (std::size_t at = 2; is_jpeg(bytes) && at < bytes.size();) {
    // A marker may follow any number of 0xff. Inside a scan, everything that is not a marker is data.
    const void* found = std::memchr(bytes.data() + at, 0xff, bytes.size() - at);
    if (!found) break;
    at = static_cast<std::size_t>(static_cast<const std::uint8_t*>(found) - bytes.data());
    while (at < bytes.size() && bytes[at] == 0xff) ++at;
    if (at == bytes.size()) break;
    const std::uint8_t marker = bytes[at++];
    // An escaped data byte 0xff, or a marker that no segment follows.
    if (marker == 0 || marker == kTemporary || is_restart(marker)) continue;
    const bool is_end = marker == kEndOfImage;
    if (!is_end && at + 2 > bytes.size()) break;
    const std::size_t length = is_end ? 0 : value_at(bytes, at, 2);
    if (!is_end && (length < 2 || at + length > bytes.size())) break;
    segments.push_back({marker, at - 2, at + length});
    if (is_end) break;
    at += length;
  }
  return segments;
}

bool has_png_end(const Bytes& bytes) {
  std::size_t at = kPngSignature.size();
  while (at + 12 <= bytes.size()) {  // length, type and checksum of a chunk
    const std::size_t length = value_at(bytes, at, 4);
    if (length > bytes.size() - at - 12) return false;
    if (std::memcmp(bytes.data() + at + 4, "IEND", 4) == 0) return true;
    at += 12 + length;
  }
  return false;
}

constexpr int kUpright = 1;  // orientation

bool begins_with(const Bytes& bytes, const Segment& segment, std::uint8_t marker, std::string_view text) {
  return segment.marker == marker && segment.end - segment.begin >= 4 + text.size() &&
         std::memcmp(bytes.data() + segment.begin + 4, text.data(), text.size()) == 0;
}

using namespace std::string_view_literals;
constexpr std::string_view kExif = "Exif\0\0"sv, kColorProfile = "ICC_PROFILE\0"sv;

struct Orientation {
  std::size_t at = 0;  // position of its directory entry
  bool is_little_endian = false, is_big_tiff = false;
  int value = kUpright;
};

/// TIFF 6.0, section 2: a header of 8 bytes, then a directory of entries of 12 bytes each. EXIF has the same form. In
/// BigTIFF, the header has 16 bytes, entries have 20, and counts and positions have 8.
std::optional<Orientation> orientation_in_tiff(const Bytes& bytes, std::size_t tiff, std::size_t end) {
  constexpr std::uint64_t kOrientationTag = 0x0112, kBigTiff = 43;
  constexpr std::array<std::size_t, 5> kTypeBytes{0, 1, 0, 2, 4};  // byte, short and long
  if (tiff + 16 > end) return std::nullopt;
  const bool is_little = bytes[tiff] == 'I';
  if (bytes[tiff + 1] != bytes[tiff] || (!is_little && bytes[tiff] != 'M')) return std::nullopt;
  const auto number = [&](std::size_t at, std::size_t count) { return value_at(bytes, at, count, is_little); };
  const bool is_big = number(tiff + 2, 2) == kBigTiff;
  const std::size_t count_bytes = is_big ? 8 : 2, entry_bytes = is_big ? 20 : 12;
  const std::uint64_t directory = is_big ? number(tiff + 8, 8) : number(tiff + 4, 4);
  if (directory > end - tiff || count_bytes > end - tiff - directory) return std::nullopt;
  std::size_t entry = tiff + directory + count_bytes;
  for (std::uint64_t left = number(tiff + directory, count_bytes); left > 0; --left, entry += entry_bytes) {
    if (entry_bytes > end - entry) return std::nullopt;
    if (number(entry, 2) != kOrientationTag) continue;
    const std::uint64_t type = number(entry + 2, 2);
    const std::size_t n_bytes = type < kTypeBytes.size() ? kTypeBytes[type] : 0;
    const std::uint64_t value = number(entry + (is_big ? 12 : 8), n_bytes);
    return Orientation{entry, is_little, is_big, value >= 1 && value <= 8 ? static_cast<int>(value) : kUpright};
  }
  return std::nullopt;
}

std::optional<Orientation> find_orientation(const Bytes& bytes) {
  for (const Segment& segment : segments_of(bytes)) {
    if (!begins_with(bytes, segment, kApp1, kExif)) continue;
    if (const auto found = orientation_in_tiff(bytes, segment.begin + 4 + kExif.size(), segment.end)) return found;
  }
  if (is_tiff(bytes)) return orientation_in_tiff(bytes, 0, bytes.size());
  // Chunks have a name and a length. In PNG, the length comes first, and a checksum follows.
  const bool is_riff = is_webp(bytes);
  if (!is_riff && !is_png(bytes)) return std::nullopt;
  for (std::size_t at = is_riff ? 12 : kPngSignature.size(); at + 8 <= bytes.size();) {
    const std::size_t length = value_at(bytes, is_riff ? at + 4 : at, 4, /*is_little_endian=*/is_riff), begin = at + 8;
    if (length > bytes.size() - begin) return std::nullopt;
    if (has_text(bytes, is_riff ? at : at + 4, is_riff ? "EXIF" : "eXIf")) {
      return orientation_in_tiff(bytes, begin + (has_text(bytes, begin, kExif) ? kExif.size() : 0), begin + length);
    }
    at = begin + length + (is_riff ? length % 2 : 4);
  }
  return std::nullopt;
}

/// Replaces the entry, because libtiff accepts more types than those that are read here.
void set_upright(const Orientation& orientation, Bytes& bytes) {
  std::size_t at = orientation.at + 2;
  const auto put = [&](std::uint64_t value, std::size_t n_bytes) {
    for (std::size_t i = 0; i < n_bytes; ++i) {
      const std::size_t place = orientation.is_little_endian ? i : n_bytes - 1 - i;
      bytes[at + place] = static_cast<std::uint8_t>(value >> 8 * i);
    }
    at += n_bytes;
  };
  constexpr std::uint64_t kShort = 3;
  const std::size_t n_bytes = orientation.is_big_tiff ? 8 : 4;
  put(kShort, 2);
  put(1, n_bytes);
  put(kUpright, 2);
  put(0, n_bytes - 2);
}

/// Turns an image as EXIF 2.3 defines the values: where row 0 and column 0 of the stored image belong. OpenCV would
/// turn it only if EXIF is the first application segment of its kind.
cv::Mat upright(const cv::Mat& stored, int orientation) {
  constexpr std::array<bool, 9> kFlipsColumns{false, false, true, true, false, false, true, true, false},
      kFlipsRows{false, false, false, true, true, false, false, true, true};
  cv::Mat image = stored.clone();
  if (orientation >= 5) cv::transpose(image, image);
  if (kFlipsColumns[orientation]) cv::flip(image, image, 1);
  if (kFlipsRows[orientation]) cv::flip(image, image, 0);
  return image;
}

ImageSize to_size(std::uint64_t width, std::uint64_t height) {
  constexpr std::uint64_t kMost = std::numeric_limits<int>::max();
  return width > kMost || height > kMost ? ImageSize{} : ImageSize{static_cast<int>(width), static_cast<int>(height)};
}

/// Windows' header, whose height is negative if the upper row comes first, or the 12 bytes of OS/2.
ImageSize bmp_size(const Bytes& bytes) {
  if (bytes.size() < 26) return {};
  const bool is_short = value_at(bytes, 14, 4, true) == 12;
  const std::size_t n = is_short ? 2 : 4;
  const std::uint64_t height = value_at(bytes, 18 + n, n, true), sign = std::uint64_t{1} << 31;
  return to_size(value_at(bytes, 18, n, true), height < sign ? height : 2 * sign - height);
}

/// RFC 9649: an extended, lossless or lossy file.
ImageSize webp_size(const Bytes& bytes) {
  if (bytes.size() < 30) return {};
  if (has_text(bytes, 12, "VP8X")) return to_size(value_at(bytes, 24, 3, true) + 1, value_at(bytes, 27, 3, true) + 1);
  constexpr std::uint64_t kSide = (1 << 14) - 1;
  if (has_text(bytes, 12, "VP8 "))
    return to_size(value_at(bytes, 26, 2, true) & kSide, value_at(bytes, 28, 2, true) & kSide);
  if (!has_text(bytes, 12, "VP8L")) return {};
  const std::uint64_t sides = value_at(bytes, 21, 4, true);
  return to_size((sides & kSide) + 1, (sides >> 14 & kSide) + 1);
}

bool is_pnm(const Bytes& bytes) {
  return bytes.size() >= 3 && bytes[0] == 'P' && bytes[1] >= '1' && bytes[1] <= '6' && std::isspace(bytes[2]) != 0;
}

/// After the first two bytes, width and height as text, with comments from # to the end of the line. As in OpenCV, one
/// byte of any value ends a number, so a # there does not begin a comment.
ImageSize pnm_size(const Bytes& bytes) {
  constexpr std::uint64_t kMost = std::uint64_t{1} << 31;
  std::array<std::uint64_t, 2> sides{};
  std::size_t at = 2;
  for (std::uint64_t& side : sides) {
    bool is_comment = false;
    for (; at < bytes.size() && (is_comment || std::isdigit(bytes[at]) == 0); ++at) {
      if (!is_comment && bytes[at] != '#' && std::isspace(bytes[at]) == 0) return {};
      is_comment = is_comment ? bytes[at] != '\n' && bytes[at] != '\r' : bytes[at] == '#';
    }
    for (; at < bytes.size() && std::isdigit(bytes[at]) != 0; ++at) side = std::min(kMost, 10 * side + bytes[at] - '0');
    ++at;
  }
  return at <= bytes.size() ? to_size(sides[0], sides[1]) : ImageSize{};
}

bool is_divisor(int resolution) {
  return resolution == 1 || resolution == 2 || resolution == 4 || resolution == 8;
}

}  // namespace

std::optional<ImageSize> image_size_from_header(const Bytes& bytes) {
  ImageSize size;
  if (is_png(bytes)) {
    if (bytes.size() < 24 || !has_text(bytes, 12, "IHDR")) return std::nullopt;  // the first chunk
    size = to_size(value_at(bytes, 16, 4), value_at(bytes, 20, 4));
  } else if (is_jpeg(bytes)) {
    for (const Segment& segment : segments_of(bytes)) {
      if (segment.marker == kStartOfScan) break;
      if (!is_start_of_frame(segment.marker)) continue;
      if (segment.end - segment.begin < 9) break;
      // after marker, length and precision
      size = to_size(value_at(bytes, segment.begin + 7, 2), value_at(bytes, segment.begin + 5, 2));
      break;
    }
  } else if (const auto tiff = tiff_size(bytes)) {
    size = tiff->image;
  } else if (is_webp(bytes)) {
    size = webp_size(bytes);
  } else if (is_pnm(bytes)) {
    size = pnm_size(bytes);
  } else if (has_text(bytes, 0, "BM")) {
    size = bmp_size(bytes);
  }
  if (size.width <= 0 || size.height <= 0) return std::nullopt;
  return size;
}

std::string image_damage(const Bytes& bytes) {
  if (bytes.empty()) return "the file is empty";
  if (is_png(bytes)) return has_png_end(bytes) ? "" : "the PNG ends before its last chunk (IEND)";
  if (is_jpeg(bytes)) {
    const std::vector<Segment> segments = segments_of(bytes);
    if (segments.empty() || segments.back().marker != kEndOfImage) return "the JPEG ends before its end marker";
    const auto is_scan = [](const Segment& segment) { return segment.marker == kStartOfScan; };
    if (std::none_of(segments.begin(), segments.end(), is_scan)) return "the JPEG has no image data";
  }
  return "";
}

int exif_orientation(const Bytes& bytes) {
  const auto found = find_orientation(bytes);
  return found ? found->value : kUpright;
}

int read_exif_orientation(const std::filesystem::path& path) {
  constexpr std::size_t kMostBytes = std::size_t{1} << 17;  // a segment has at most 64 KiB, and EXIF comes early
  std::error_code error;
  if (!std::filesystem::exists(path, error)) return kUpright;
  FileReader file(path);
  Bytes bytes(static_cast<std::size_t>(std::min<std::uint64_t>(kMostBytes, file.remaining())));
  file.read_bytes(bytes.data(), bytes.size());
  return is_jpeg(bytes) ? exif_orientation(bytes) : kUpright;
}

template <class Value>
Raster<Value> turn_upright(const Raster<Value>& stored, int orientation) {
  const int type = CV_MAKETYPE(cv::DataType<Value>::depth, stored.channels);
  const cv::Mat image =
      upright({stored.height, stored.width, type, const_cast<Value*>(stored.pixels.data())}, orientation);
  Raster<Value> turned(image.cols, image.rows, stored.channels);
  image.copyTo(cv::Mat(image.rows, image.cols, type, turned.pixels.data()));
  return turned;
}
template Image8 turn_upright(const Image8&, int);
template Depth16 turn_upright(const Depth16&, int);

void clear_tiff_orientation(Bytes& bytes) {
  if (!is_tiff(bytes)) return;
  if (const auto found = find_orientation(bytes)) set_upright(*found, bytes);
}

std::optional<Bytes> turned_upright(const Bytes& jpeg) {
  const auto orientation = find_orientation(jpeg);
  if (!orientation || !is_jpeg(jpeg)) return std::nullopt;
  constexpr int kQuality = 98;
  Bytes encoded;
  try {
    const cv::Mat stored = cv::imdecode(jpeg, cv::IMREAD_ANYCOLOR | cv::IMREAD_IGNORE_ORIENTATION);
    if (stored.empty()) return std::nullopt;
    const cv::Mat image = upright(stored, orientation->value);
    if (!cv::imencode(".jpg", image, encoded, {cv::IMWRITE_JPEG_QUALITY, kQuality})) return std::nullopt;
  } catch (const cv::Exception&) {
    return std::nullopt;
  }
  Bytes source = jpeg;
  set_upright(*orientation, source);
  // JFIF's segment, APP0, comes first.
  const Segment first = segments_of(encoded).front();
  const auto place = encoded.begin() + static_cast<std::ptrdiff_t>(first.marker == kApp0 ? first.end : 2);
  Bytes result(encoded.begin(), place);
  for (const Segment& segment : segments_of(source)) {
    if (begins_with(source, segment, kApp1, kExif) || begins_with(source, segment, kApp2, kColorProfile)) {
      result.insert(result.end(), source.data() + segment.begin, source.data() + segment.end);
    }
  }
  result.insert(result.end(), place, encoded.end());
  return result;
}

ImageSize divided_size(ImageSize size, int divisor) {
  const auto divided = [&](std::int64_t side) {
    return std::max(1, static_cast<int>((2 * side + divisor) / (2 * std::int64_t{divisor})));
  };
  return {divided(size.width), divided(size.height)};
}

ImageSize training_size(ImageSize size, int resolution) {
  if (is_divisor(resolution)) {
    const auto divided = [&](double side) {  // halves to even
      return std::max(1, static_cast<int>(std::nearbyint(side / resolution)));
    };
    return {divided(size.width), divided(size.height)};
  }
  const int width = resolution == -1 ? kMaxDefaultWidth : resolution;
  if (width >= size.width) return size;
  const std::int64_t height = std::int64_t{size.height} * width / size.width;
  return {width, std::max(1, static_cast<int>(height))};
}

bool has_same_aspect(ImageSize other, ImageSize size) {
  const std::int64_t across = std::int64_t{other.width} * size.height, down = std::int64_t{other.height} * size.width;
  return std::abs(across - down) <= std::max({size.width, size.height, other.width, other.height});
}

bool is_turned(ImageSize other, ImageSize size) {
  return !has_same_aspect(other, size) && has_same_aspect({other.height, other.width}, size);
}

void check_resolution(int resolution) {
  if (resolution == -1 || is_divisor(resolution) || resolution >= kMinWidth) return;
  input_error("-r ", resolution, resolution < 1 ? "" : detail::concat(": images would be ", resolution, " px wide"),
              ": expected 1, 2, 4 or 8 to divide the size, -1 for a width of at most ", kMaxDefaultWidth,
              " px, or a width of at least ", kMinWidth, " px");
}

}  // namespace b3dgs
