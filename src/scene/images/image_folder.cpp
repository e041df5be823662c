#include "scene/images/image_folder.h"

#include <algorithm>
#include <array>
#include <cctype>
#include <charconv>

#include "core/check.h"

namespace b3dgs {
namespace {

namespace fs = std::filesystem;

constexpr std::array<const char*, 10> kExtensions{".jpg",  ".jpeg", ".png", ".bmp", ".tif",
                                                  ".tiff", ".webp", ".ppm", ".pgm", ".pnm"};

std::string lower_case(std::string text) {
  std::transform(text.begin(), text.end(), text.begin(), [](unsigned char c) { return std::tolower(c); });
  return text;
}

std::string key_of(const fs::path& relative) {
  return lower_case(fs::path(relative).replace_extension().generic_string());
}

bool is_file(const fs::path& path) {
  std::error_code error;
  return fs::is_regular_file(path, error);
}

// 4, and "images" in `base`, for "images_4"; 0 for names of another form.
int divisor_of(const std::string& images, std::string& base) {
  const std::size_t underscore = images.rfind('_');
  if (underscore == std::string::npos || underscore == 0) return 0;
  int divisor = 0;
  const char* end = images.data() + images.size();
  const auto result = std::from_chars(images.data() + underscore + 1, end, divisor);
  if (result.ec != std::errc() || result.ptr != end || divisor < 1) return 0;
  base = images.substr(0, underscore);
  return divisor;
}

std::string list_subfolders(const fs::path& source) {
  std::vector<std::string> names;
  std::error_code error;
  for (const fs::directory_entry& entry : fs::directory_iterator(source, error)) {
    if (entry.is_directory(error)) names.push_back(entry.path().filename().string());
  }
  std::sort(names.begin(), names.end());
  std::string list;
  for (const std::string& name : names) list += (list.empty() ? "" : ", ") + name;
  return list.empty() ? "no folders" : list;
}

}  // namespace

bool has_image_extension(const fs::path& path) {
  const std::string extension = lower_case(path.extension().string());
  return std::find(kExtensions.begin(), kExtensions.end(), extension) != kExtensions.end();
}

ImageFolder::ImageFolder(const fs::path& source, const std::string& images)
    : source_(source), folder_(source / images), images_(images) {
  if (fs::is_directory(folder_)) {
    list_files();
    return;
  }
  std::string base;
  const int divisor = divisor_of(images, base);
  if (divisor > 0 && fs::is_directory(source / base)) {
    folder_ = source / base;
    divisor_ = divisor;
    note_ = detail::concat(images, "/ not found: using ", base, "/ with images reduced by ", divisor);
    list_files();
  } else if (images == "images") {  // the names may be relative to the scene folder
    folder_ = source;
    note_ = "images/ not found: searching the scene folder itself";
  } else {
    input_error(folder_.string(), ": image folder not found; the scene folder contains ", list_subfolders(source),
                "; choose one with -i");
  }
}

void ImageFolder::list_files() {
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

std::vector<std::string> ImageFolder::names_in_folder(const std::string& name) const {
  std::string path = name;
  std::replace(path.begin(), path.end(), '\\', '/');
  std::vector<std::string> names{path};
  for (const std::string& prefix : {std::string("images/"), images_ + "/"}) {
    if (path.rfind(prefix, 0) == 0) names.push_back(path.substr(prefix.size()));
  }
  return names;
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
    } else if (find(other->second).empty()) {  // both are only similar: one of them would get a wrong photograph
      input_error(file.string(), ": the registered images ", other->second, " and ", name,
                  " both match only this file; keep their sub-folders in the image folder");
    }
  }
  return files;
}

fs::path ImageFolder::find(const std::string& name) const {
  const std::vector<std::string> names = names_in_folder(name);
  for (const std::string& candidate : names) {
    if (is_file(folder_ / candidate)) return folder_ / candidate;
  }
  return is_file(source_ / names.front()) ? source_ / names.front() : fs::path();
}

fs::path ImageFolder::find_similar(const std::string& name) const {
  const std::vector<std::string> names = names_in_folder(name);
  for (const std::string& candidate : names) {
    const auto entry = by_path_.find(key_of(candidate));
    if (entry != by_path_.end() && !entry->second.empty()) return entry->second;
  }
  const fs::path shortest = names.back();
  const auto entry = by_name_.find(key_of(shortest.filename()));
  if (entry == by_name_.end() || entry->second.empty()) return {};
  // left/0001.jpg is not right/0001.jpg.
  const bool is_flat = !shortest.has_parent_path() || entry->second.parent_path() == folder_;
  return is_flat ? entry->second : fs::path();
}

std::size_t ImageFolder::count_others(const std::set<fs::path>& used) const {
  return static_cast<std::size_t>(
      std::count_if(files_.begin(), files_.end(), [&](const fs::path& file) { return used.count(file) == 0; }));
}

}  // namespace b3dgs
