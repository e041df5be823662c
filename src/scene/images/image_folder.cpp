#include "scene/images/image_folder.h"

#include <algorithm>
#include <array>
#include <charconv>
#include <cstdint>

#include "core/check.h"
#include "core/files/unicode_names.h"
#include "core/text.h"

namespace b3dgs {
namespace {

namespace fs = std::filesystem;

constexpr std::array<const char*, 10> kExtensions{".jpg",  ".jpeg", ".png", ".bmp", ".tif",
                                                  ".tiff", ".webp", ".ppm", ".pgm", ".pnm"};

std::string key_of(const fs::path& relative) {
  return lower_case(composed_name(fs::path(relative).replace_extension().generic_string()));
}

bool is_folder(const fs::path& path) {
  std::error_code error;
  return fs::is_directory(path, error);
}

// Returns 4, and "images" in `base`, for "images_4". Returns 0 for names of another form.
int divisor_of(const std::string& images, std::string& base) {
  const std::size_t underscore = images.rfind('_');
  if (underscore == std::string::npos || underscore == 0) return 0;
  int divisor = 0;
  const char* end = images.data() + images.size();
  const auto result = std::from_chars(images.data() + underscore + 1, end, divisor);
  base = images.substr(0, underscore);
  return result.ec == std::errc() && result.ptr == end ? std::max(divisor, 0) : 0;
}

std::string list_subfolders(const fs::path& source) {
  std::set<std::string> names;
  std::error_code error;
  for (const fs::directory_entry& entry : fs::directory_iterator(source, error)) {
    if (is_folder(entry.path())) names.insert(entry.path().filename().string());
  }
  std::string list;
  for (const std::string& name : names) list += (list.empty() ? "" : ", ") + name;
  return list.empty() ? "no folders" : list;
}

// Returns the name of an image with '/' between folders, and without a leading "images/" or name of the image folder.
std::vector<std::string> names_in_folder(const std::string& name, const std::string& images) {
  std::string path = name;
  std::replace(path.begin(), path.end(), '\\', '/');
  std::vector<std::string> names{path};
  for (const std::string& prefix : {std::string("images/"), images + "/"}) {
    if (path.rfind(prefix, 0) == 0) names.push_back(path.substr(prefix.size()));
  }
  return names;
}

}  // namespace

bool is_file(const fs::path& path) {
  std::error_code error;
  return fs::is_regular_file(path, error);
}

bool has_image_extension(const fs::path& path) {
  const std::string extension = lower_case(path.extension().string());
  return std::find(kExtensions.begin(), kExtensions.end(), extension) != kExtensions.end();
}

ImageFolder::ImageFolder(const fs::path& source, const std::string& images)
    : source_(source), folder_(source / images), images_(images) {
  if (!is_folder(folder_)) {
    std::string base;
    const int divisor = divisor_of(images, base);
    if (divisor > 0 && is_folder(source / base)) {
      folder_ = source / base;
      divisor_ = divisor;
      note_ = detail::concat(images, "/ not found: using ", base, "/ with images reduced by ", divisor);
    } else if (images == "images") {  // the names may be relative to the scene folder
      folder_ = source;
      note_ = "images/ not found: searching the scene folder itself";
      return;
    } else {
      input_error(folder_.string(), ": image folder not found; the scene folder contains ", list_subfolders(source),
                  "; choose one with -i");
    }
  }
  std::error_code error;
  const auto options = fs::directory_options::skip_permission_denied;
  for (fs::recursive_directory_iterator entry(folder_, options, error), end; !error && entry != end;
       entry.increment(error)) {
    if (is_file(entry->path()) && has_image_extension(entry->path())) files_.push_back(entry->path());
  }
  std::sort(files_.begin(), files_.end());
  const auto add = [](Index& index, const std::string& key, const fs::path& file) {
    const auto [entry, is_new] = index.emplace(key, file);
    if (!is_new) entry->second.clear();
  };
  for (const fs::path& file : files_) {
    add(by_path_, key_of(file.lexically_relative(folder_)), file);
    add(by_name_, key_of(file.filename()), file);
  }
}

std::map<std::string, fs::path> ImageFolder::find_all(const std::vector<std::string>& names) const {
  std::map<std::string, fs::path> files;
  std::map<fs::path, std::string> owners;
  for (const std::string& name : names) {
    const fs::path file = find(name);
    if (file.empty()) continue;
    files[name] = file;
    owners[file] = name;
  }
  for (const std::string& name : names) {
    if (files.count(name)) continue;
    const fs::path file = find_similar(name);
    if (file.empty()) continue;
    const auto other = owners.find(file);
    if (other == owners.end()) {
      files[name] = file;
      owners[file] = name;
    } else if (find(other->second).empty()) {  // neither name is exact, so one of them would get a wrong photograph
      input_error(file.string(), ": the registered images ", other->second, " and ", name,
                  " both match only this file; keep their sub-folders in the image folder");
    }
  }
  return files;
}

fs::path ImageFolder::find(const std::string& name) const {
  const std::vector<std::string> names = names_in_folder(name, images_);
  for (const std::string& candidate : names) {
    if (is_file(folder_ / candidate)) return folder_ / candidate;
  }
  return is_file(source_ / names.front()) && !replaces(name) ? source_ / names.front() : fs::path();
}

bool ImageFolder::replaces(const std::string& name) const {
  return images_ != "images" && names_in_folder(name, images_)[0].rfind("images/", 0) == 0 &&
         !find_similar(name).empty();
}

fs::path ImageFolder::find_similar(const std::string& name) const {
  const auto find_in = [](const Index& index, const fs::path& path) {
    const auto entry = index.find(key_of(path));
    return entry == index.end() ? fs::path() : entry->second;
  };
  const std::vector<std::string> names = names_in_folder(name, images_);
  for (const std::string& candidate : names) {
    if (const fs::path file = find_in(by_path_, candidate); !file.empty()) return file;
  }
  const fs::path shortest = names.back(), file = find_in(by_name_, shortest.filename());
  // left/0001.jpg is not right/0001.jpg.
  return !shortest.has_parent_path() || file.parent_path() == folder_ ? file : fs::path();
}

std::size_t ImageFolder::count_others(const std::set<fs::path>& used) const {
  return static_cast<std::size_t>(
      std::count_if(files_.begin(), files_.end(), [&](const fs::path& file) { return used.count(file) == 0; }));
}

fs::path find_mask_folder(const fs::path& source, const std::string& masks) {
  if (masks.empty()) return is_folder(source / "masks") ? source / "masks" : fs::path();
  for (const fs::path& folder : {source / masks, fs::path(masks)}) {
    if (is_folder(folder)) return folder;
  }
  input_error("--masks ", masks, ": folder not found, neither in ", source.string(), " nor in the current folder; ",
              "leave --masks out to train without masks");
}

fs::path find_mask(const fs::path& folder, const std::string& image, const std::string& images) {
  if (folder.empty()) return {};
  for (const std::string& candidate : names_in_folder(image, images)) {
    const std::string stem = fs::path(candidate).replace_extension().generic_string();
    for (const std::string& mask : {candidate + ".png", stem + ".png", stem + ".mask.png", candidate}) {
      if (const fs::path file = find_in_any_form(folder, mask); !file.empty()) return file;
    }
  }
  return {};
}

Image8 read_mask(const fs::path& file, ImageSize size, bool invert, int orientation) {
  Image8 image = read_image(file, /*white_background=*/false);
  if (is_turned(image.size(), size) && orientation != 1) image = turn_upright(image, orientation);
  if (!has_same_aspect(image.size(), size)) {
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
