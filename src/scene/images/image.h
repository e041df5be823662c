// Images in memory.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

namespace b3dgs {

struct ImageSize {
  int width = 0, height = 0;  // px

  bool operator==(const ImageSize& other) const { return width == other.width && height == other.height; }
  bool operator!=(const ImageSize& other) const { return !(*this == other); }
};

/// Row-major, interleaved, 8 bits per channel; three channels are RGB.
struct Image8 {
  int width = 0, height = 0, channels = 3;
  std::vector<std::uint8_t> pixels;  // [height, width, channels]

  Image8() = default;
  Image8(int w, int h, int c) : width(w), height(h), channels(c), pixels(static_cast<std::size_t>(w) * h * c) {}
};

/// Row-major, 16 bits: an inverse depth map, up to scale and offset.
struct Depth16 {
  int width = 0, height = 0;
  std::vector<std::uint16_t> values;  // [height, width]

  Depth16() = default;
  Depth16(int w, int h) : width(w), height(h), values(static_cast<std::size_t>(w) * static_cast<std::size_t>(h)) {}
};

}  // namespace b3dgs
