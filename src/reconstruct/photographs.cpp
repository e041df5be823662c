#include "reconstruct/photographs.h"

#include <fcntl.h>
#include <unistd.h>

#include <algorithm>
#include <cctype>
#include <cstdio>
#include <fstream>
#include <iterator>
#include <map>
#include <utility>

#include "core/check.h"
#include "core/files/atomic_file.h"
#include "core/files/file_reader.h"
#include "scene/images/image_folder.h"
#include "scene/images/image_header.h"
#include "scene/images/image_io.h"

namespace b3dgs {
namespace {

namespace fs = std::filesystem;

bool is_hidden(const fs::path& path) {
  const std::string name = path.filename().string();
  return name.empty() || name[0] == '.' || name == "__MACOSX";
}

bool is_raw_or_heic(const fs::path& path) {
  std::string extension = path.extension().string();
  std::transform(extension.begin(), extension.end(), extension.begin(),
                 [](unsigned char c) { return std::tolower(c); });
  constexpr const char* kExtensions[] = {".heic", ".heif", ".avif", ".dng", ".cr2", ".cr3", ".nef", ".arw", ".raf"};
  return std::any_of(std::begin(kExtensions), std::end(kExtensions), [&](const char* e) { return extension == e; });
}

std::int64_t time_of(const fs::path& path) {
  return static_cast<std::int64_t>(fs::last_write_time(path).time_since_epoch().count());
}

/// The whole file, to see whether it is complete. Larger ones than any camera's are not read.
std::string damage_of(const fs::path& path) {
  constexpr std::uint64_t kMostBytes = 1 << 29;
  FileReader file(path);
  if (file.remaining() == 0) return "the file is empty";
  if (file.remaining() > kMostBytes) return "";
  std::vector<std::uint8_t> bytes(file.remaining());
  file.read_bytes(bytes.data(), bytes.size());
  return image_damage(bytes);
}

bool is_same_file(const fs::path& a, const fs::path& b) {
  std::error_code error;
  if (!fs::exists(b, error)) return false;
  return fs::equivalent(a, b, error) || (fs::file_size(a) == fs::file_size(b) && time_of(a) == time_of(b));
}

/// A hard link, or a copy. Appears complete or not at all.
void link_or_copy(const fs::path& from, const fs::path& to) {
  const fs::path unfinished = to.string() + ".unfinished";
  std::error_code error;
  fs::remove(unfinished, error);
  fs::create_hard_link(from, unfinished, error);
  if (error) {
    fs::copy_file(from, unfinished, fs::copy_options::overwrite_existing, error);
    if (!error) fs::last_write_time(unfinished, fs::last_write_time(from), error);
  }
  if (!error && !fs::equivalent(unfinished, to, error)) {
    error.clear();  // of equivalent(), where there is no such file yet
    fs::rename(unfinished, to, error);
  }
  if (error) {
    std::error_code ignored;
    fs::remove(unfinished, ignored);
    io_error("cannot copy ", from.string(), " to ", to.string(), ": ", error.message());
  }
}

}  // namespace

std::vector<Photograph> list_photographs(const fs::path& folder, const std::vector<fs::path>& except) {
  std::vector<Photograph> photographs;
  std::size_t n_others = 0;
  std::error_code error;
  fs::recursive_directory_iterator entries(folder, fs::directory_options::follow_directory_symlink, error);
  if (error) input_error(folder.string(), ": the folder cannot be read (", error.message(), ")");
  for (; entries != fs::recursive_directory_iterator(); entries.increment(error)) {
    const fs::path& path = entries->path();
    std::error_code ignored;
    const bool is_folder = entries->is_directory(ignored);
    const bool is_left_out =
        is_hidden(path) || (is_folder && std::any_of(except.begin(), except.end(), [&](const fs::path& other) {
                              return fs::equivalent(path, other, ignored);
                            }));
    if (is_left_out) {
      if (is_folder) entries.disable_recursion_pending();
      continue;
    }
    if (is_folder || !entries->is_regular_file(ignored)) continue;
    if (has_image_extension(path)) {
      photographs.push_back({path.lexically_relative(folder).generic_string(), fs::file_size(path), time_of(path)});
    } else if (is_raw_or_heic(path)) {
      ++n_others;
    }
  }
  if (error) input_error(folder.string(), ": a folder in it cannot be read (", error.message(), ")");
  if (photographs.size() < 2) {
    input_error(folder.string(), ": ", photographs.empty() ? "no photographs" : "only one photograph",
                " (expected at least 2 files such as .jpg or .png",
                n_others > 0 ? detail::concat(", found ", n_others, " raw or HEIC files: convert them to JPEG") : "",
                ")", n_others == 0 ? "; a scene needs 20 or more, each overlapping its neighbours by two thirds" : "");
  }
  std::sort(photographs.begin(), photographs.end(),
            [](const Photograph& a, const Photograph& b) { return a.name < b.name; });
  return photographs;
}

CheckedPhotographs check_photographs(const fs::path& folder, const std::vector<std::string>& names,
                                     const std::function<void(std::size_t done)>& progress) {
  CheckedPhotographs result;
  std::size_t n_done = 0;
  for (const std::string& name : names) {
    try {
      const ImageSize size = read_image_size(folder / name);
      const std::string damage = damage_of(folder / name);
      if (!damage.empty()) input_error((folder / name).string(), ": ", damage);
      result.names.push_back(name);
      result.sizes.push_back(size);
    } catch (const InputError& error) {
      result.damaged.emplace_back(error.what());
    }
    progress(++n_done);
  }
  return result;
}

void place_photographs(const fs::path& from, const fs::path& to, const std::vector<Photograph>& photographs,
                       bool may_replace, const std::function<void(std::size_t done)>& progress) {
  std::size_t n_done = 0;
  for (const Photograph& photograph : photographs) {
    const fs::path source = from / photograph.name, target = to / photograph.name;
    if (!is_same_file(source, target)) {
      std::error_code error;
      if (!may_replace && fs::exists(target, error)) {
        input_error(target.string(), ": another file is there than ", source.string(),
                    "; move it, or choose another scene folder");
      }
      create_folder(target.parent_path());
      link_or_copy(source, target);
    }
    progress(++n_done);
  }
}

std::vector<CameraGroup> group_by_camera(const CheckedPhotographs& photographs, const std::string& camera_per) {
  constexpr std::size_t kMostSizes = 8;
  const std::vector<CameraGroup> all{{"all", photographs.names, false}};
  if (camera_per != "size") return all;
  std::map<std::string, CameraGroup> groups;
  for (std::size_t i = 0; i < photographs.names.size(); ++i) {
    const std::string label = detail::concat(photographs.sizes[i].width, "x", photographs.sizes[i].height);
    CameraGroup& group = groups[label];
    group.label = label;
    group.is_single_camera = true;
    group.names.push_back(photographs.names[i]);
  }
  if (groups.size() > kMostSizes) return all;
  std::vector<CameraGroup> result;
  for (auto& [label, group] : groups) result.push_back(std::move(group));
  return result;
}

}  // namespace b3dgs
