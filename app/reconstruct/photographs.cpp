#include "app/reconstruct/photographs.h"

#include <fcntl.h>
#include <linux/fs.h>
#include <sys/ioctl.h>
#include <unistd.h>

#include <algorithm>
#include <chrono>
#include <iterator>
#include <map>
#include <memory>
#include <optional>
#include <set>
#include <system_error>
#include <utility>

#include "core/check.h"
#include "core/descriptor.h"
#include "core/files/atomic_file.h"
#include "core/files/file_reader.h"
#include "core/files/own_files.h"
#include "core/text.h"
#include "scene/images/image.h"
#include "scene/images/image_folder.h"

namespace b3dgs {
namespace {

namespace fs = std::filesystem;

bool is_hidden(const fs::path& path) {
  const std::string name = path.filename().string();
  return name.empty() || name[0] == '.' || name == "__MACOSX";
}

bool is_raw_or_heic(const fs::path& path) {
  const std::string extension = lower_case(path.extension().string());
  constexpr const char* kExtensions[] = {".heic", ".heif", ".avif", ".dng", ".cr2", ".cr3", ".nef", ".arw", ".raf"};
  return std::any_of(std::begin(kExtensions), std::end(kExtensions), [&](const char* e) { return extension == e; });
}

std::int64_t time_of(const fs::path& path) {
  return static_cast<std::int64_t>(fs::last_write_time(path).time_since_epoch().count());
}

std::vector<std::uint8_t> read_file(const fs::path& path) {
  FileReader file(path);
  std::vector<std::uint8_t> bytes(file.remaining());
  file.read_bytes(bytes.data(), bytes.size());
  return bytes;
}

/// Reads the whole file to check that it is complete. Files larger than those of any camera are not read.
std::string damage_of(const fs::path& path) {
  constexpr std::uint64_t kMostBytes = 1 << 29;
  const std::uint64_t bytes = FileReader(path).remaining();
  if (bytes == 0) return "the file is empty";
  return bytes > kMostBytes ? "" : image_damage(read_file(path));
}

/// Returns whether place_photographs() has nothing to do.
bool is_placed(const fs::path& from, const fs::path& to) {
  std::error_code error;
  if (!fs::exists(to, error)) return false;
  if (fs::equivalent(from, to, error)) return true;
  const bool has_size = fs::file_size(from, error) == fs::file_size(to, error);
  if (has_size && time_of(from) == time_of(to)) return true;
  // Some file systems round the time. Turned copies have another size.
  constexpr std::chrono::seconds kMostRounding{2};
  OwnFiles* own = OwnFiles::of(to);
  if (own == nullptr || !own->is_own(to)) return false;
  const auto difference = fs::last_write_time(from) - fs::last_write_time(to);
  return difference <= kMostRounding && difference >= -kMostRounding && (has_size || read_exif_orientation(from) != 1);
}

/// Lets `to` share the blocks of `from` until one of them is changed. Returns false if the file system does not support
/// this.
bool clone_file(const fs::path& from, const fs::path& to) {
  const Descriptor source = open_for_reading(from), target(::open(to.c_str(), O_WRONLY | O_CLOEXEC));
  return source && target && ::ioctl(target.fd(), FICLONE, source.fd()) == 0;
}

/// @return whether it was turned
bool copy_photograph(const fs::path& from, const fs::path& to) {
  AtomicFile file(to);
  std::optional<std::vector<std::uint8_t>> upright;
  if (read_exif_orientation(from) != 1) upright = turned_upright(read_file(from));
  std::error_code error;
  if (upright) {
    file.write(upright->data(), upright->size());
  } else if (!clone_file(from, file.temporary())) {
    fs::copy_file(from, file.temporary(), fs::copy_options::overwrite_existing, error);
  }
  if (!error) fs::last_write_time(file.temporary(), fs::last_write_time(from), error);
  if (error) {
    io_error("cannot copy ", from.string(), " to ", to.string(), " (", error.message(),
             "); photographs that you move to ", "SCENE/images need not be copied: give this folder as PHOTOS");
  }
  file.commit();
  return upright.has_value();
}

/// COLMAP removes blanks at both ends of the names in its list, one per line. The end is an extension.
void check_name(const fs::path& folder, const std::string& name) {
  if (!detail::has_control_characters(name) && name[0] != ' ') return;
  input_error((folder / name).string(), ": expected a name without ",
              name[0] == ' ' ? "a blank at the beginning" : "control characters such as line breaks",
              "; rename this file or folder");
}

/// Returns whether a folder below `top` is a link to a parent folder or to one that contains `top`, which would be
/// listed again.
bool leads_back(const fs::directory_entry& folder, const fs::path& top) {
  std::error_code error;
  if (!folder.is_symlink(error)) return false;
  const fs::path target = real_path(folder.path());
  for (fs::path above = folder.path().parent_path();; above = above.parent_path()) {
    const fs::path real = real_path(above);
    if (std::mismatch(target.begin(), target.end(), real.begin(), real.end()).first == target.end()) return true;
    if (above.native().size() <= top.native().size()) return false;
  }
}

}  // namespace

PhotographList list_photographs(const fs::path& folder, const std::vector<fs::path>& except) {
  PhotographList list;
  std::vector<Photograph>& photographs = list.photographs;
  std::vector<std::unique_ptr<OwnFiles>> written;  // in sub-folders, by this program: copies in a scene, renders
  std::set<std::string> stems;  // of photographs: many cameras write a raw file and a JPEG file of each
  std::error_code error;
  fs::recursive_directory_iterator entries(folder, fs::directory_options::follow_directory_symlink, error);
  if (error) input_error(folder.string(), ": the folder cannot be read (", error.message(), ")");
  for (; entries != fs::recursive_directory_iterator(); entries.increment(error)) {
    const fs::path& path = entries->path();
    std::error_code ignored;
    const bool is_folder = entries->is_directory(ignored);
    if (is_folder && fs::exists(path / OwnFiles::kRecord, ignored)) written.push_back(std::make_unique<OwnFiles>(path));
    const bool is_left_out = is_hidden(path) || (is_folder && leads_back(*entries, folder)) ||
                             (is_folder && std::any_of(except.begin(), except.end(), [&](const fs::path& other) {
                                return fs::equivalent(path, other, ignored);
                              }));
    if (is_left_out) {
      if (is_folder) entries.disable_recursion_pending();
      continue;
    }
    if (is_folder || !entries->is_regular_file(ignored)) continue;
    const auto is_own = [&](const std::unique_ptr<OwnFiles>& files) { return files->is_own(path); };
    if (std::any_of(written.begin(), written.end(), is_own)) continue;
    if (has_image_extension(path)) {
      const fs::path name = path.lexically_relative(folder);
      check_name(folder, name.generic_string());
      photographs.push_back({name.generic_string(), fs::file_size(path), time_of(path)});
      stems.insert(fs::path(name).replace_extension().generic_string());
    } else if (is_raw_or_heic(path)) {
      list.unreadable.push_back(path.lexically_relative(folder).generic_string());
    }
  }
  if (error) input_error(folder.string(), ": a folder in it cannot be read (", error.message(), ")");
  std::vector<std::string>& others = list.unreadable;
  others.erase(std::remove_if(others.begin(), others.end(),
                              [&](const std::string& name) {
                                return stems.count(fs::path(name).replace_extension().generic_string()) > 0;
                              }),
               others.end());
  std::sort(others.begin(), others.end());
  const std::size_t n_others = others.size();
  if (photographs.size() < 2) {
    input_error(folder.string(), ": ", photographs.empty() ? "no photographs" : "only one photograph",
                " (expected at least 2 files such as .jpg or .png",
                n_others > 0 ? detail::concat(", found ", n_others, " raw or HEIC files: convert them to JPEG") : "",
                ")", n_others == 0 ? "; a scene needs 20 or more, each overlapping its neighbours by two thirds" : "");
  }
  std::sort(photographs.begin(), photographs.end(),
            [](const Photograph& a, const Photograph& b) { return a.name < b.name; });
  return list;
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

std::string find_in_the_way(const fs::path& from, const fs::path& to, const std::vector<Photograph>& photographs) {
  for (const Photograph& photograph : photographs) {
    std::error_code error;
    const fs::path target = to / photograph.name;
    const bool is_taken = fs::exists(fs::symlink_status(target, error));
    if (is_taken && !is_placed(from / photograph.name, target)) return photograph.name;
    // Handles a file with the name of a required folder.
    for (fs::path folder = target.parent_path(); folder.native().size() > to.native().size();
         folder = folder.parent_path()) {
      if (fs::exists(fs::symlink_status(folder, error)) && !fs::is_directory(folder, error)) return photograph.name;
    }
  }
  return "";
}

std::size_t place_photographs(const fs::path& from, const fs::path& to, const std::vector<Photograph>& photographs,
                              const std::function<void(std::size_t done)>& progress) {
  std::size_t n_done = 0, n_turned = 0;
  for (const Photograph& photograph : photographs) {
    const fs::path source = from / photograph.name, target = to / photograph.name;
    if (!is_placed(source, target)) n_turned += copy_photograph(source, target) ? 1 : 0;
    progress(++n_done);
  }
  return n_turned;
}

std::size_t count_turned(const fs::path& folder, const std::vector<Photograph>& photographs) {
  return static_cast<std::size_t>(std::count_if(
      photographs.begin(), photographs.end(),
      [&](const Photograph& photograph) { return read_exif_orientation(folder / photograph.name) != 1; }));
}

std::vector<CameraGroup> group_by_camera(const CheckedPhotographs& photographs, const std::string& camera_per) {
  constexpr std::size_t kMostSizes = 8;
  const std::vector<CameraGroup> all{{photographs.names, false}};
  if (camera_per != "size") return all;
  std::map<std::string, CameraGroup> groups;  // by size
  for (std::size_t i = 0; i < photographs.names.size(); ++i) {
    const ImageSize& size = photographs.sizes[i];
    CameraGroup& group = groups[detail::concat(size.width, "x", size.height)];
    group.is_single_camera = true;
    group.names.push_back(photographs.names[i]);
  }
  if (groups.size() > kMostSizes) return all;  // and extract_command() gives each photograph its own camera
  std::vector<CameraGroup> result;
  for (auto& [size, group] : groups) result.push_back(std::move(group));
  return result;
}

}  // namespace b3dgs
