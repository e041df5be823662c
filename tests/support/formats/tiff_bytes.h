// Makes TIFF files byte by byte.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

namespace b3dgs::test {

struct TiffOptions {
  bool is_separate = false;          // the planes of the samples follow each other
  bool is_big = false;               // BigTIFF
  int tile = 0;                      // px, side of the square tiles, of which `samples` holds one; 0: a single strip
  std::uint32_t rows_per_strip = 0;  // 0: the height
  int orientation = 0;               // EXIF's values; 0: no tag
};

/// Returns an uncompressed little-endian TIFF. `extra` are the kinds of its last samples (ExtraSamples), 1
/// premultiplied and 2 straight alpha.
inline std::string tiff_of(std::uint32_t width, std::uint32_t height, int bits, int n_samples,
                           const std::vector<std::uint32_t>& extra, const std::string& samples,
                           const TiffOptions& options = {}) {
  const auto number = [](std::uint64_t value, int bytes) {
    std::string text;
    for (int i = 0; i < bytes; ++i) text += static_cast<char>(value >> 8 * i & 0xff);
    return text;
  };
  const auto n = static_cast<std::uint32_t>(n_samples), n_planes = options.is_separate ? n : 1;
  const auto plane_bytes = static_cast<std::uint32_t>(samples.size()) / n_planes;
  const bool is_tiled = options.tile > 0;
  const int wide = options.is_big ? 8 : 4;  // bytes of counts, positions and values
  const std::uint32_t header_bytes = options.is_big ? 16 : 8, list_bytes = 64;
  const std::uint32_t n_entries = (is_tiled ? 11 : 10) - (extra.empty() ? 1 : 0) + (options.orientation > 0 ? 1 : 0);
  // Position of values that need more bytes than an entry has.
  const std::uint32_t lists = header_bytes + (options.is_big ? 8 + 20 * n_entries : 2 + 12 * n_entries) + wide;
  std::string entries, values;
  const auto add = [&](std::uint32_t tag, int bytes_each, const std::vector<std::uint32_t>& numbers) {
    std::string list;
    for (const std::uint32_t value : numbers) list += number(value, bytes_each);
    entries += number(tag, 2) + number(bytes_each == 2 ? 3 : 4, 2) + number(numbers.size(), wide);
    if (list.size() > static_cast<std::size_t>(wide)) {
      entries += number(lists + values.size(), wide);
      values += list;
    } else {
      entries += list + std::string(static_cast<std::size_t>(wide) - list.size(), '\0');
    }
  };
  std::vector<std::uint32_t> offsets;
  for (std::uint32_t i = 0; i < n_planes; ++i) offsets.push_back(lists + list_bytes + i * plane_bytes);
  const std::vector<std::uint32_t> sizes(n_planes, plane_bytes);
  const auto tile = static_cast<std::uint32_t>(options.tile);
  add(256, 4, {width});
  add(257, 4, {height});
  add(258, 2, std::vector<std::uint32_t>(n, static_cast<std::uint32_t>(bits)));
  add(262, 2, {n >= 3 ? 2u : 1u});  // RGB, or grey with black as 0
  if (!is_tiled) add(273, 4, offsets);
  if (options.orientation > 0) add(274, 2, {static_cast<std::uint32_t>(options.orientation)});
  add(277, 2, {n});
  if (!is_tiled) add(278, 4, {options.rows_per_strip > 0 ? options.rows_per_strip : height});
  if (!is_tiled) add(279, 4, sizes);
  add(284, 2, {options.is_separate ? 2u : 1u});
  if (is_tiled) {
    add(322, 4, {tile});
    add(323, 4, {tile});
    add(324, 4, offsets);
    add(325, 4, sizes);
  }
  if (!extra.empty()) add(338, 2, extra);
  values.resize(list_bytes);
  const std::string header = options.is_big ? std::string("II+\0\x08\0\0\0", 8) : std::string("II*\0", 4);
  return header + number(header_bytes, wide) + number(n_entries, options.is_big ? 8 : 2) + entries + number(0, wide) +
         values + samples;
}

}  // namespace b3dgs::test
