#include "scene/images/mask_folder.h"

#include <algorithm>
#include <cstdint>
#include <cstdlib>
#include <vector>

#include "core/check.h"
#include "scene/images/image_io.h"

namespace b3dgs {
namespace {

namespace fs = std::filesystem;

constexpr const char* kDefaultFolder = "masks";
constexpr const char* kNoFolder = "none";

bool is_folder(const fs::path& path) {
  std::error_code error;
  return fs::is_directory(path, error);
}

bool is_file(const fs::path& path) {
  std::error_code error;
  return fs::is_regular_file(path, error);
}

}  // namespace

MaskFolder::MaskFolder(const fs::path& source, const std::string& masks, const std::string& images)
    : images_(images), is_asked_for_(!masks.empty() && masks != kNoFolder), is_refused_(masks == kNoFolder) {
  if (is_refused_) return;
  if (!is_asked_for_) {
    if (is_folder(source / kDefaultFolder)) folder_ = source / kDefaultFolder;
    return;
  }
  for (const fs::path& folder : {source / masks, fs::path(masks)}) {
    if (!is_folder(folder)) continue;
    folder_ = folder;
    return;
  }
  input_error("--masks ", masks, ": folder not found, neither in ", source.string(), " nor in the current folder; ",
              "leave --masks out to train without masks");
}

fs::path MaskFolder::find(const std::string& image) const {
  if (folder_.empty()) return {};
  std::string name = image;
  std::replace(name.begin(), name.end(), '\\', '/');
  std::vector<std::string> names{name};
  for (const std::string& prefix : {std::string("images/"), images_ + "/"}) {
    if (name.rfind(prefix, 0) == 0) names.push_back(name.substr(prefix.size()));
  }
  for (const std::string& candidate : names) {
    const std::string stem = fs::path(candidate).replace_extension().generic_string();
    for (const std::string& mask : {candidate + ".png", stem + ".png", stem + ".mask.png", candidate}) {
      if (is_file(folder_ / mask)) return folder_ / mask;
    }
  }
  return {};
}

Image8 read_mask(const fs::path& file, ImageSize size, bool invert) {
  const Image8 image = read_image(file, /*white_background=*/false);
  // Equal up to the rounding of one side by less than a pixel.
  const std::int64_t across = std::int64_t{image.width} * size.height, down = std::int64_t{image.height} * size.width;
  if (std::abs(across - down) >= std::max(size.width, size.height)) {
    input_error(file.string(), ": expected the aspect ratio of its photograph, ", size.width, " x ", size.height,
                " px, found a mask of ", image.width, " x ", image.height, " px");
  }
  Image8 mask(size.width, size.height, 1);
  const std::uint8_t light = invert ? 0 : 255, dark = invert ? 255 : 0;
  std::uint8_t* to = mask.pixels.data();
  for (std::int64_t y = 0; y < size.height; ++y) {
    const std::int64_t row = (2 * y + 1) * image.height / (2 * std::int64_t{size.height});  // the nearest
    for (std::int64_t x = 0; x < size.width; ++x) {
      const std::int64_t column = (2 * x + 1) * image.width / (2 * std::int64_t{size.width});
      const std::uint8_t* rgb = image.pixels.data() + 3 * (row * image.width + column);
      *to++ = std::max({rgb[0], rgb[1], rgb[2]}) >= 128 ? light : dark;
    }
  }
  return mask;
}

}  // namespace b3dgs
