// The photographs of a reconstruction: finding them, checking them, and copying them into the scene folder.
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

/// Returns the image files in a folder and its sub-folders. Skips hidden files and folders, and those in `except`.
/// @throws InputError if there are fewer than two, with a description of other files, or if a name cannot be in
/// COLMAP's list of names, one per line
PhotographList list_photographs(const std::filesystem::path& folder, const std::vector<std::filesystem::path>& except);

struct CheckedPhotographs {
  std::vector<std::string> names;    // usable photographs
  std::vector<ImageSize> sizes;      // of each
  std::vector<std::string> damaged;  // one line for each of the others: file, reason
};

/// Reads the header of each photograph, and checks whether JPEG and PNG files are complete. @param progress may throw
/// to stop
CheckedPhotographs check_photographs(const std::filesystem::path& folder, const std::vector<std::string>& names,
                                     const std::function<void(std::size_t done)>& progress);

/// Returns the first of the photographs in `from` for which there is a different file at `to`/NAME, or "". The file is
/// the same photograph if it has the same size and time of change, or if place_photographs() wrote it.
std::string find_in_the_way(const std::filesystem::path& from, const std::filesystem::path& to,
                            const std::vector<Photograph>& photographs);

/// Copies photographs from `from`/NAME to `to`/NAME, with their time of change, unless they exist already. JPEG files
/// that lie on their side according to their EXIF data are turned upright. A later change of a copy or an original does
/// not affect the other, but the copies take no additional space if the file system supports that. @return the number
/// of turned photographs @throws IoError; errors from `progress`
std::size_t place_photographs(const std::filesystem::path& from, const std::filesystem::path& to,
                              const std::vector<Photograph>& photographs,
                              const std::function<void(std::size_t done)>& progress);

/// Returns how many of the photographs lie on their side or upside down according to their EXIF data.
std::size_t count_turned(const std::filesystem::path& folder, const std::vector<Photograph>& photographs);

/// Photographs that COLMAP processes in one call, which share a camera or not.
struct CameraGroup {
  std::vector<std::string> names;
  bool is_single_camera = false;  // all of them
};

/// Groups for --camera_per: "size" makes a group with one camera for each size of photographs. With more than 8 sizes,
/// each photograph gets its own camera instead. "folder" and "photo" are one group that COLMAP divides.
std::vector<CameraGroup> group_by_camera(const CheckedPhotographs& photographs, const std::string& camera_per);

}  // namespace b3dgs
