// The photograph of a view: in memory, or on disk, from where it can be read again and again.
#pragma once

#include <cstdint>
#include <filesystem>
#include <memory>
#include <mutex>
#include <string>
#include <utility>
#include <vector>

#include "scene/cameras/distortion.h"
#include "scene/cameras/undistorter_cache.h"
#include "scene/images/image.h"
#include "scene/images/image_io.h"
#include "scene/images/image_memory.h"
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
  int lens_group = -1;        // of the undistorters; -1: the lens is a pinhole
};

/// What the photographs of a scene share.
struct SceneImages {
  SceneImages(const ImageMemory::Plan& plan, std::shared_ptr<UndistorterCache> undistorters, bool white_background)
      : memory(plan), undistorters(std::move(undistorters)), white_background(white_background) {}

  ImageMemory memory;
  const std::shared_ptr<UndistorterCache> undistorters;
  const bool white_background;  // what RGBA images are composited on
};

/// Threads may share it.
class ViewImage {
 public:
  /// In memory for good.
  explicit ViewImage(Image8 image);
  /// On disk.
  ViewImage(ViewSource source, std::shared_ptr<SceneImages> shared);

  ImageSize size() const { return size_; }  // px
  std::int64_t n_bytes() const { return std::int64_t{3} * size_.width * size_.height; }
  /// -1: none. Reading images of one group together saves making its map more than once.
  int lens_group() const { return source_.lens_group; }
  /// Of the scene; null if the image is not on disk.
  ImageMemory* memory() const { return shared_ ? &shared_->memory : nullptr; }

  /// The image if it is in memory, else null.
  std::shared_ptr<const Image8> held() const;
  /// The image from memory or, decoded now, from disk. @throws InputError naming the file if it is missing, damaged, or
  /// has changed its size since the scene was loaded
  std::shared_ptr<const Image8> read() const;
  /// The same, written to n_bytes() bytes: RGB, row by row.
  void read_into(std::uint8_t* rgb) const;

  /// Keeps the image in memory, which the caller has counted (ImageMemory::try_hold).
  void hold(std::shared_ptr<const Image8> image);

 private:
  void decode_into(std::uint8_t* rgb) const;

  ImageSize size_;
  ViewSource source_;
  std::shared_ptr<SceneImages> shared_;
  mutable std::mutex mutex_;
  std::shared_ptr<const Image8> held_;
};

/// Reads the photographs of `views` that are not in memory, with all threads, and keeps them there: in the order of the
/// views, as long as ImageMemory has room. @throws InputError for the first one that cannot be read
void hold_images(const std::vector<View>& views, const ProgressFn& progress);

}  // namespace b3dgs
