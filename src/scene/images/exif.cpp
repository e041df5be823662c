#include "scene/images/exif.h"

#include <algorithm>
#include <cstddef>
#include <fstream>
#include <opencv2/core.hpp>
#include <opencv2/imgcodecs.hpp>

namespace b3dgs {
namespace {

using Bytes = std::vector<std::uint8_t>;

constexpr std::uint8_t kApp0 = 0xe0, kApp1 = 0xe1, kApp2 = 0xe2, kStartOfScan = 0xda, kEndOfImage = 0xd9;
constexpr int kUpright = 1;
constexpr int kQuality = 98;

struct Segment {
  std::uint8_t marker = 0;
  std::size_t begin = 0, end = 0;  // from the marker's 0xff on
};

bool is_jpeg(const Bytes& bytes) {
  return bytes.size() >= 3 && bytes[0] == 0xff && bytes[1] == 0xd8 && bytes[2] == 0xff;
}

/// The complete segments before the image data.
std::vector<Segment> segments_of(const Bytes& bytes) {
  std::vector<Segment> segments;
  if (!is_jpeg(bytes)) return segments;
  for (std::size_t at = 2; at + 4 <= bytes.size() && bytes[at] == 0xff;) {
    const std::uint8_t marker = bytes[at + 1];
    if (marker == 0xff) {  // padding
      ++at;
      continue;
    }
    if (marker == kStartOfScan || marker == kEndOfImage) break;
    const std::size_t length = std::size_t{bytes[at + 2]} << 8 | bytes[at + 3];
    if (length < 2 || at + 2 + length > bytes.size()) break;
    segments.push_back({marker, at, at + 2 + length});
    at += 2 + length;
  }
  return segments;
}

bool has_text(const Bytes& bytes, const Segment& segment, const char* text, std::size_t length) {
  return segment.end - segment.begin >= 4 + length &&
         std::equal(text, text + length, bytes.begin() + static_cast<std::ptrdiff_t>(segment.begin + 4));
}

bool is_exif(const Bytes& bytes, const Segment& segment) {
  return segment.marker == kApp1 && has_text(bytes, segment, "Exif\0\0", 6);
}

bool is_color_profile(const Bytes& bytes, const Segment& segment) {
  return segment.marker == kApp2 && has_text(bytes, segment, "ICC_PROFILE", 12);
}

struct Orientation {
  std::size_t at = 0;  // of its two bytes
  bool is_little_endian = false;
  int value = kUpright;
};

/// TIFF 6.0, section 2: a header of 8 bytes, then a directory of entries of 12 bytes each.
std::optional<Orientation> orientation_in(const Bytes& bytes, const Segment& segment) {
  constexpr std::size_t kEntryBytes = 12;
  constexpr std::uint32_t kOrientationTag = 0x0112, kShort = 3;
  const std::size_t tiff = segment.begin + 10;
  if (tiff + 8 > segment.end) return std::nullopt;
  const bool is_little = bytes[tiff] == 'I';
  if (bytes[tiff + 1] != bytes[tiff] || (!is_little && bytes[tiff] != 'M')) return std::nullopt;
  const auto number = [&](std::size_t at, std::size_t count) {
    std::uint32_t value = 0;
    for (std::size_t i = 0; i < count; ++i) value = value << 8 | bytes[is_little ? at + count - 1 - i : at + i];
    return value;
  };
  const std::size_t directory = tiff + number(tiff + 4, 4);
  if (directory + 2 > segment.end) return std::nullopt;
  const std::size_t n_entries = number(directory, 2);
  for (std::size_t i = 0; i < n_entries; ++i) {
    const std::size_t entry = directory + 2 + i * kEntryBytes;
    if (entry + kEntryBytes > segment.end) return std::nullopt;
    if (number(entry, 2) != kOrientationTag || number(entry + 2, 2) != kShort) continue;
    const auto value = static_cast<int>(number(entry + 8, 2));
    if (value < 1 || value > 8) return std::nullopt;
    return Orientation{entry + 8, is_little, value};
  }
  return std::nullopt;
}

std::optional<Orientation> find_orientation(const Bytes& bytes) {
  for (const Segment& segment : segments_of(bytes)) {
    if (!is_exif(bytes, segment)) continue;
    if (const auto found = orientation_in(bytes, segment)) return found;
  }
  return std::nullopt;
}

/// As EXIF 2.3 defines the values: where row 0 and column 0 of the stored image belong.
cv::Mat upright(const cv::Mat& stored, int orientation) {
  cv::Mat image = stored;
  if (orientation >= 5) cv::transpose(image, image);
  const bool flips_columns = orientation == 2 || orientation == 3 || orientation == 6 || orientation == 7;
  const bool flips_rows = orientation == 3 || orientation == 4 || orientation == 7 || orientation == 8;
  cv::Mat result;
  if (flips_columns || flips_rows) {
    cv::flip(image, result, flips_columns && flips_rows ? -1 : flips_columns ? 1 : 0);
  } else {
    result = image;
  }
  return result;
}

void append(Bytes& to, const Bytes& from, std::size_t begin, std::size_t end) {
  to.insert(to.end(), from.begin() + static_cast<std::ptrdiff_t>(begin),
            from.begin() + static_cast<std::ptrdiff_t>(end));
}

}  // namespace

int exif_orientation(const Bytes& beginning) {
  const auto found = find_orientation(beginning);
  return found ? found->value : kUpright;
}

int read_exif_orientation(const std::filesystem::path& path) {
  constexpr std::size_t kMostBytes = std::size_t{1} << 17;  // a segment has at most 64 KiB, and EXIF comes early
  Bytes bytes(kMostBytes);
  std::ifstream file(path, std::ios::binary);
  file.read(reinterpret_cast<char*>(bytes.data()), static_cast<std::streamsize>(bytes.size()));
  bytes.resize(static_cast<std::size_t>(std::max<std::streamsize>(file.gcount(), 0)));
  return exif_orientation(bytes);
}

std::optional<Bytes> turned_upright(const Bytes& jpeg) {
  const auto orientation = find_orientation(jpeg);
  if (!orientation) return std::nullopt;
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
  source[orientation->at] = orientation->is_little_endian ? kUpright : 0;
  source[orientation->at + 1] = orientation->is_little_endian ? 0 : kUpright;
  // JFIF's segment, APP0, comes first.
  std::size_t place = 2;
  const std::vector<Segment> written = segments_of(encoded);
  if (!written.empty() && written[0].marker == kApp0) place = written[0].end;
  Bytes result;
  append(result, encoded, 0, place);
  for (const Segment& segment : segments_of(source)) {
    if (is_exif(source, segment) || is_color_profile(source, segment)) {
      append(result, source, segment.begin, segment.end);
    }
  }
  append(result, encoded, place, encoded.size());
  return result;
}

}  // namespace b3dgs
