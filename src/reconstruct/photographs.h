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

struct PhotographList {
  std::vector<Photograph> photographs;  // sorted by name
  std::vector<std::string> unreadable;  // raw and HEIC files without a photograph of the same name beside them, sorted
};

/// The image files in a folder and its sub-folders. Hidden files and folders are passed over, and so are those in
/// `except`. @throws InputError if there are fewer than two, saying what there is instead, or if a name cannot stand in
/// a list of names, one per line, as COLMAP reads it
PhotographList list_photographs(const std::filesystem::path& folder, const std::vector<std::filesystem::path>& except);

struct CheckedPhotographs {
  std::vector<std::string> names;    // that can be used
  std::vector<ImageSize> sizes;      // of each
  std::vector<std::string> damaged;  // one line for each of the others: file, reason
};

/// Reads the header of each photograph, and whether JPEG and PNG files are complete.
/// @param progress may throw to stop
CheckedPhotographs check_photographs(const std::filesystem::path& folder, const std::vector<std::string>& names,
                                     const std::function<void(std::size_t done)>& progress);

/// The first of the photographs in `from` for which there is another file at `to`/NAME; empty if there is none. The
/// file is the photograph if it has the same size and time of change, or if place_photographs() wrote it.
std::string find_in_the_way(const std::filesystem::path& from, const std::filesystem::path& to,
                            const std::vector<Photograph>& photographs);

/// Copies photographs from `from`/NAME to `to`/NAME, with their time of change, unless they are there already. JPEG
/// files whose EXIF data says that they lie on their side are turned upright meanwhile. The copies share no bytes with
/// the originals that a later change of either could reach; where the file system can, they take no additional space.
/// @return how many were turned
/// @throws IoError; what `progress` throws
std::size_t place_photographs(const std::filesystem::path& from, const std::filesystem::path& to,
                              const std::vector<Photograph>& photographs,
                              const std::function<void(std::size_t done)>& progress);

/// How many of the photographs lie on their side or upside down, as their EXIF data says.
std::size_t count_turned(const std::filesystem::path& folder, const std::vector<Photograph>& photographs);

/// Photographs that share a camera, as COLMAP is to treat them in one call.
struct CameraGroup {
  std::vector<std::string> names;
  bool is_single_camera = false;  // all of them
};

/// Groups for --camera_per: "size" makes a group with one camera for each size of photographs, unless there are more
/// than 8 sizes; each photograph then gets its own camera. "folder" and "photo" are one group that COLMAP divides.
std::vector<CameraGroup> group_by_camera(const CheckedPhotographs& photographs, const std::string& camera_per);

}  // namespace b3dgs
