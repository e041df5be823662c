// Finds the files of the images that a COLMAP model names, and their masks.
#pragma once

#include <filesystem>
#include <map>
#include <set>
#include <string>
#include <unordered_map>
#include <vector>

#include "scene/images/image.h"

namespace b3dgs {

/// Whether there is a regular file; false also for one that cannot be looked at.
bool is_file(const std::filesystem::path& path);

/// Whether the name ends like that of an image file, in upper or lower case.
bool has_image_extension(const std::filesystem::path& path);

class ImageFolder {
 public:
  /// `images` is the folder inside `source`. If "images_4" does not exist but "images" does, that is used instead, with
  /// divisor() 4; if "images" does not exist, `source` itself. @throws InputError if another folder does not exist
  ImageFolder(const std::filesystem::path& source, const std::string& images);

  const std::filesystem::path& folder() const { return folder_; }
  int divisor() const { return divisor_; }
  /// Which folder is used instead, for the user; "" if none is.
  const std::string& note() const { return note_; }

  /// The files of registered images, by name. An image without a file of its name gets one with a similar name that no
  /// other image has; images without either are left out. @throws InputError if two images match only the same file
  std::map<std::string, std::filesystem::path> find_all(const std::vector<std::string>& names) const;

  /// The file with this name, empty if there is none: relative to the folder, with or without a leading "images/", or
  /// to the scene folder.
  std::filesystem::path find(const std::string& name) const;

  /// Whether a file of the folder that -i names, found only by a similar name, takes the place of one in images/.
  bool replaces(const std::string& name) const;

  /// Number of image files in the folder that are not in `used`.
  std::size_t count_others(const std::set<std::filesystem::path>& used) const;

 private:
  using Index = std::unordered_map<std::string, std::filesystem::path>;  // empty path: several files have the key

  /// A file with the same name but another extension, case or Unicode form, or the same last part where either the name
  /// or the file has no sub-folder; empty if there is none, or more than one.
  std::filesystem::path find_similar(const std::string& name) const;

  std::filesystem::path source_, folder_;
  std::string images_;
  int divisor_ = 1;
  std::string note_;
  std::vector<std::filesystem::path> files_;
  Index by_path_, by_name_;  // keys in lower case, with composed letters, without extension
};

/// The folder of masks, by which black is left out of training: `masks` inside `source`, or else inside the current
/// folder; for "" "masks" inside `source`, or an empty path. @throws InputError if a folder that was asked for does not
/// exist
std::filesystem::path find_mask_folder(const std::filesystem::path& source, const std::string& masks);

/// The mask of the image "a.jpg": "a.jpg.png", "a.png", "a.mask.png" or "a.jpg", with the image's sub-folders and
/// without a leading "images/" or name of the image folder; empty if there is none.
std::filesystem::path find_mask(const std::filesystem::path& folder, const std::string& image,
                                const std::string& images);

/// A mask of one channel and `size`: 0 where the file is darker than half of white or transparent, 255 elsewhere; the
/// other way round with `invert`. The file may have any size of the photograph's aspect ratio, `size` (px), also before
/// the photograph was turned upright from its EXIF orientation. @throws InputError with the file's name
Image8 read_mask(const std::filesystem::path& file, ImageSize size, bool invert, int orientation = 1);

}  // namespace b3dgs
