// Images of the registered views: decoded, undistorted and reduced by a few threads.
#pragma once

#include <cstdint>
#include <filesystem>
#include <memory>
#include <string>
#include <vector>

#include "scene/distortion.h"
#include "scene/image.h"
#include "scene/image_io.h"
#include "scene/scene.h"

namespace b3dgs {

/// What is known of a view before its image is decoded.
struct ViewSource {
  std::string name;  // in the model
  std::filesystem::path file;
  std::uint32_t camera_id = 0;
  std::string camera_place;   // "FILE: camera ID", for messages
  Lens lens;                  // in pixels of the file
  ImageSize file_size, size;  // px, on disk and to train on; `size` is not larger
};

struct LoadedImage {
  std::shared_ptr<const Image8> image;
  std::shared_ptr<const Image8> valid;  // null: all valid; shared by the images of one camera and size
};

/// In the order of `sources`. @throws InputError for the first image found that cannot be decoded, or if the memory
/// that the images need is not there.
std::vector<LoadedImage> load_view_images(const std::vector<ViewSource>& sources, bool white_background,
                                          const ProgressFn& progress);

}  // namespace b3dgs
