#include "scene/images/image_header.h"

#include <algorithm>
#include <array>
#include <cstring>

namespace b3dgs {
namespace {

using Bytes = std::vector<std::uint8_t>;

constexpr std::array<std::uint8_t, 8> kPngSignature{0x89, 'P', 'N', 'G', '\r', '\n', 0x1a, '\n'};

std::uint32_t big_endian(const Bytes& bytes, std::size_t at, int count) {
  std::uint32_t value = 0;
  for (int i = 0; i < count; ++i) value = value << 8 | bytes[at + i];
  return value;
}

bool is_png(const Bytes& bytes) {
  return bytes.size() >= kPngSignature.size() && std::equal(kPngSignature.begin(), kPngSignature.end(), bytes.begin());
}

bool is_jpeg(const Bytes& bytes) {
  return bytes.size() >= 3 && bytes[0] == 0xff && bytes[1] == 0xd8 && bytes[2] == 0xff;
}

// Second bytes of JPEG markers, after 0xff (ITU-T T.81, table B.1).
constexpr std::uint8_t kEndOfImage = 0xd9, kStartOfScan = 0xda;
bool is_restart(std::uint8_t marker) {
  return marker >= 0xd0 && marker <= 0xd7;
}
bool is_start_of_frame(std::uint8_t marker) {
  return marker >= 0xc0 && marker <= 0xcf && marker != 0xc4 && marker != 0xc8 && marker != 0xcc;  // DHT, JPG, DAC
}

// Calls visit(marker, position of its segment's length, length) for each marker until it returns false or the
// end-of-image marker is visited. Returns false if the bytes end before that.
template <class Visit>
bool walk_jpeg(const Bytes& bytes, Visit&& visit) {
  std::size_t at = 2;
  for (;;) {
    // A marker may be preceded by any number of 0xff; inside a scan, everything that is not a marker is data.
    const void* found = at < bytes.size() ? std::memchr(bytes.data() + at, 0xff, bytes.size() - at) : nullptr;
    if (!found) return false;
    at = static_cast<std::size_t>(static_cast<const std::uint8_t*>(found) - bytes.data());
    while (at < bytes.size() && bytes[at] == 0xff) ++at;
    if (at >= bytes.size()) return false;
    const std::uint8_t marker = bytes[at++];
    if (marker == 0 || is_restart(marker))
      continue;  // an escaped data byte 0xff or a restart marker: no segment follows
    if (marker == kEndOfImage) {
      visit(marker, at, std::size_t{0});
      return true;
    }
    if (at + 2 > bytes.size()) return false;
    const std::size_t length = big_endian(bytes, at, 2);
    if (length < 2 || at + length > bytes.size()) return false;
    if (!visit(marker, at, length)) return true;
    at += length;
  }
}

// Calls visit(type, position of the data, length) for each chunk until it returns false. Returns false if the bytes end
// before that.
template <class Visit>
bool walk_png(const Bytes& bytes, Visit&& visit) {
  std::size_t at = kPngSignature.size();
  while (at + 12 <= bytes.size()) {  // length, type and checksum of a chunk
    const std::size_t length = big_endian(bytes, at, 4);
    if (length > bytes.size() - at - 12) return false;
    if (!visit(std::string(bytes.begin() + at + 4, bytes.begin() + at + 8), at + 8, length)) return true;
    at += 12 + length;
  }
  return false;
}

}  // namespace

std::optional<ImageSize> image_size_from_header(const Bytes& bytes) {
  ImageSize size;
  if (is_png(bytes)) {
    if (bytes.size() < 24) return std::nullopt;  // IHDR is the first chunk: width at byte 16, height at 20
    size = {static_cast<int>(big_endian(bytes, 16, 4)), static_cast<int>(big_endian(bytes, 20, 4))};
  } else if (is_jpeg(bytes)) {
    walk_jpeg(bytes, [&](std::uint8_t marker, std::size_t at, std::size_t length) {
      if (is_start_of_frame(marker) && length >= 7) {  // length, precision, height, width
        size = {static_cast<int>(big_endian(bytes, at + 5, 2)), static_cast<int>(big_endian(bytes, at + 3, 2))};
      }
      return !is_start_of_frame(marker) && marker != kStartOfScan;
    });
  }
  if (size.width <= 0 || size.height <= 0) return std::nullopt;
  return size;
}

std::string image_damage(const Bytes& bytes) {
  if (bytes.empty()) return "the file is empty";
  if (is_png(bytes)) {
    const bool is_whole =
        walk_png(bytes, [](const std::string& type, std::size_t, std::size_t) { return type != "IEND"; });
    return is_whole ? "" : "the PNG ends before its last chunk (IEND)";
  }
  if (is_jpeg(bytes)) {
    bool has_scan = false;
    const bool is_whole = walk_jpeg(bytes, [&](std::uint8_t marker, std::size_t, std::size_t) {
      has_scan = has_scan || marker == kStartOfScan;
      return true;
    });
    if (!is_whole) return "the JPEG ends before its end marker";
    if (!has_scan) return "the JPEG has no image data";
  }
  return "";
}

}  // namespace b3dgs
