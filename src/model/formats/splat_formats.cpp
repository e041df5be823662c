#include "model/formats/splat_formats.h"

#include <string>

#include "core/check.h"
#include "core/text.h"
#include "model/formats/ply.h"
#include "model/formats/spz.h"

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

}  // namespace b3dgs
