#include "model/formats/splat_formats.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <string>

#include "core/check.h"
#include "core/text.h"

namespace b3dgs {
namespace {

namespace fs = std::filesystem;

/// The format to read `path` in: a PLY may have any name.
const SplatFormat& format_to_read(const fs::path& path) {
  const SplatFormat* format = find_splat_format(path);
  return format != nullptr ? *format : splat_formats().front();
}

}  // namespace

const std::vector<SplatFormat>& splat_formats() {
  static const std::vector<SplatFormat> formats{
      {"PLY", ".ply", [](const fs::path& path) { return read_splat_ply(path); }, write_splat_ply, is_splat_ply},
      {"SPZ", ".spz", [](const fs::path& path) { return read_spz(path); },
       [](const fs::path& path, const SplatCloud& cloud) { write_spz(path, cloud); }, nullptr},
  };
  return formats;
}

const SplatFormat* find_splat_format(const fs::path& path) {
  const std::string extension = lower_case(path.extension().string());
  for (const SplatFormat& format : splat_formats()) {
    if (extension == format.extension) return &format;
  }
  return nullptr;
}

SplatCloud read_splats(const fs::path& path) {
  return format_to_read(path).read(path);
}

bool holds_splats(const fs::path& path) {
  const SplatFormat& format = format_to_read(path);
  return format.holds_splats == nullptr || format.holds_splats(path);
}

void write_splats(const fs::path& path, const SplatCloud& cloud) {
  const SplatFormat* format = find_splat_format(path);
  if (format == nullptr) {
    std::string known;
    for (const SplatFormat& row : splat_formats()) {
      known += detail::concat(known.empty() ? "" : ", ", row.extension, " (", row.name, ")");
    }
    input_error(path.string(), ": unknown file format for Gaussians; expected a file name that ends in ", known);
  }
  format->write(path, cloud);
}

std::vector<double> world_positions(const SplatCloud& cloud, std::size_t at_most) {
  const std::size_t step = 3 * std::max<std::size_t>(1, cloud.means.size() / 3 / at_most);
  std::vector<double> positions;
  for (std::size_t i = 0; i < cloud.means.size(); i += step) {
    const std::array<double, 3> position = cloud.frame.to_world(&cloud.means[i]);
    positions.insert(positions.end(), position.begin(), position.end());
  }
  return positions;
}

void change_frame(const CoordinateFrame& to, SplatCloud& cloud) {
  if (cloud.frame == to) return;
  for (std::size_t i = 0; i < cloud.means.size(); i += 3) {
    const std::array<double, 3> world = cloud.frame.to_world(&cloud.means[i]), local = to.from_world(world.data());
    for (std::size_t axis = 0; axis < 3; ++axis) cloud.means[i + axis] = static_cast<float>(local[axis]);
  }
  const double log_ratio = std::log(cloud.frame.unit / to.unit);
  for (float& scale : cloud.log_scales) scale = static_cast<float>(scale + log_ratio);
  cloud.frame = to;
}

}  // namespace b3dgs
