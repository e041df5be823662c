// The photographs of a reconstruction: which there are, which can be used, and their way into the scene folder.
#pragma once

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <string>
#include <vector>

#include "scene/images/image.h"

namespace b3dgs {

struct Photograph {
  std::string name;  // relative to its folder, '/' between folders
  std::uintmax_t bytes = 0;
  std::int64_t changed = 0;  // time of the last change, in the file system's unit
};

/// The image files in a folder and its sub-folders, sorted by name. Hidden files and folders are passed over, and so
/// are those in `except`. @throws InputError if there are fewer than two, saying what there is instead
std::vector<Photograph> list_photographs(const std::filesystem::path& folder,
                                         const std::vector<std::filesystem::path>& except);

struct CheckedPhotographs {
  std::vector<std::string> names;    // that can be used
  std::vector<ImageSize> sizes;      // of each
  std::vector<std::string> damaged;  // one line for each of the others: file, reason
};

/// Reads the header of each photograph, and whether JPEG and PNG files are complete.
/// @param progress may throw to stop
CheckedPhotographs check_photographs(const std::filesystem::path& folder, const std::vector<std::string>& names,
                                     const std::function<void(std::size_t done)>& progress);

/// Makes `to`/NAME the same file as `from`/NAME: a hard link, or a copy with the same time of change where links are
/// not possible. Files that are there already with the same size and time are kept. `may_replace`: of other files, an
/// earlier call put these there. @throws InputError if another file of that name is there; IoError; what `progress`
/// throws
void place_photographs(const std::filesystem::path& from, const std::filesystem::path& to,
                       const std::vector<Photograph>& photographs, bool may_replace,
                       const std::function<void(std::size_t done)>& progress);

/// Photographs that share a camera, as COLMAP is to treat them in one call.
struct CameraGroup {
  std::string label;  // "1920x1080", or "all"
  std::vector<std::string> names;
  bool is_single_camera = false;  // all of them
};

/// Groups for --camera_per: "size" makes a group with one camera for each size of photographs, unless there are more
/// than 8 sizes; each photograph then gets its own camera. "folder" and "photo" are one group that COLMAP divides.
std::vector<CameraGroup> group_by_camera(const CheckedPhotographs& photographs, const std::string& camera_per);

}  // namespace b3dgs
