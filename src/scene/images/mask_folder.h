// Finds the masks of photographs: black is left out of training.
#pragma once

#include <filesystem>
#include <string>

#include "scene/images/image.h"

namespace b3dgs {

class MaskFolder {
 public:
  /// `masks`: a folder inside `source`, or else inside the current folder; "" is "masks" if the scene has that folder,
  /// "none" no folder. @throws InputError if a folder that was asked for does not exist
  MaskFolder(const std::filesystem::path& source, const std::string& masks, const std::string& images);

  const std::filesystem::path& folder() const { return folder_; }  // empty: none
  bool is_asked_for() const { return is_asked_for_; }
  bool is_refused() const { return is_refused_; }  // "none"

  /// The mask of the image "a.jpg": "a.jpg.png", "a.png", "a.mask.png" or "a.jpg", with the image's sub-folders and
  /// without a leading "images/"; empty if there is none.
  std::filesystem::path find(const std::string& image) const;

 private:
  std::filesystem::path folder_;
  std::string images_;
  bool is_asked_for_ = false, is_refused_ = false;
};

/// A mask of one channel and `size`: 0 where the file is darker than half of white or transparent, 255 elsewhere; the
/// other way round with `invert`. The file may have any size of the photograph's aspect ratio, `size` (px).
/// @throws InputError with the file's name
Image8 read_mask(const std::filesystem::path& file, ImageSize size, bool invert);

}  // namespace b3dgs
