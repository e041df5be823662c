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

/// Returns whether there is a regular file. Returns false also if its status cannot be read.
bool is_file(const std::filesystem::path& path);

/// Returns whether the name has the extension of an image file, in upper or lower case.
bool has_image_extension(const std::filesystem::path& path);

class ImageFolder {
 public:
  /// `images` is the folder inside `source`. If "images_4" does not exist but "images" does, that is used with
  /// divisor() 4. If "images" does not exist, `source` itself is used. @throws InputError if another folder does not
  /// exist
  ImageFolder(const std::filesystem::path& source, const std::string& images);

  const std::filesystem::path& folder() const { return folder_; }
  int divisor() const { return divisor_; }
  /// Tells the user which folder is used instead, or "".
  const std::string& note() const { return note_; }

  /// Finds the files of registered images, by name. An image without a file of its name gets one with a similar name
  /// that no other image has. Images without either are left out. @throws InputError if two images match only the same
  /// file
  std::map<std::string, std::filesystem::path> find_all(const std::vector<std::string>& names) const;

  /// Finds the file with this name, relative to the folder, with or without a leading "images/", or to the scene
  /// folder. Returns an empty path if there is none.
  std::filesystem::path find(const std::string& name) const;

  /// Returns whether a file of the -i folder, found only by a similar name, replaces one in images/.
  bool replaces(const std::string& name) const;

  /// Returns the number of image files in the folder that are not in `used`.
  std::size_t count_others(const std::set<std::filesystem::path>& used) const;

 private:
  using Index = std::unordered_map<std::string, std::filesystem::path>;  // empty path: several files have the key

  /// Finds a file with the same name but another extension, case or Unicode form. The last part of the path is enough
  /// if either the name or the file has no sub-folder. Returns an empty path if there is none, or more than one.
  std::filesystem::path find_similar(const std::string& name) const;

  std::filesystem::path source_, folder_;
  std::string images_;
  int divisor_ = 1;
  std::string note_;
  std::vector<std::filesystem::path> files_;
  Index by_path_, by_name_;  // keys in lower case, with composed letters, without extension
};

/// Finds the folder of masks, whose black areas are left out of training: `masks` inside `source`, or else inside the
/// current folder. For "", returns "masks" inside `source`, or an empty path. @throws InputError if `masks` is given
/// and does not exist
std::filesystem::path find_mask_folder(const std::filesystem::path& source, const std::string& masks);

/// Finds the mask of the image "a.jpg": "a.jpg.png", "a.png", "a.mask.png" or "a.jpg", with the image's sub-folders and
/// without a leading "images/" or name of the image folder. Returns an empty path if there is none.
std::filesystem::path find_mask(const std::filesystem::path& folder, const std::string& image,
                                const std::string& images);

/// Reads a mask as one channel of `size`: 0 where the file is darker than half of white or transparent, 255 elsewhere.
/// `invert` swaps the two. The file may have any size with the aspect ratio of the photograph, whose size is `size`
/// (px), also as it was before the photograph was turned upright from its EXIF orientation. @throws InputError with the
/// file's name
Image8 read_mask(const std::filesystem::path& file, ImageSize size, bool invert, int orientation = 1);

}  // namespace b3dgs
