// The photographs of a scene: their sources, shared data, and the decoded image of a view, which is cached in memory or
// read from disk each time.
#pragma once

#include <cstdint>
#include <filesystem>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "scene/cameras/camera.h"
#include "scene/cameras/undistort.h"
#include "scene/images/image.h"
#include "scene/images/image_memory.h"
#include "scene/scene.h"

namespace b3dgs {

/// A view, and what is known about it before its photograph is decoded.
struct ViewSource : View {
  std::uint32_t image_id = 0, camera_id = 0;
  std::string camera_place;    // "FILE: camera ID", for errors
  Camera file_camera;          // camera of the photograph on disk, with its lens, without its pose
  ImageSize file_size, size;   // px, on disk but upright, and for training; `size` is not larger
  int orientation = 1;         // EXIF orientation from which the photograph is turned upright
  bool is_on_side = false;     // its sides are those of its camera swapped, but nothing says how to turn it
  int lens_group = -1;         // index in SceneImages::undistorters; -1: the photograph is used as it is
  std::string warning;         // about the lens; or ""
  bool is_masked_out = false;  // no pixel is valid

  bool is_reduced() const { return size != file_size; }
};

/// Data shared by the photographs of a scene.
struct SceneImages {
  SceneImages(const ImageMemory::Plan& plan, std::unique_ptr<UndistorterCache> undistorters, bool white_background)
      : memory(plan), undistorters(std::move(undistorters)), white_background(white_background) {}

  ImageMemory memory;
  const std::unique_ptr<UndistorterCache> undistorters;
  const bool white_background;  // background of RGBA images
};

/// Assigns the sources their lens groups and masks, which it reads with all threads. Divides the host memory between
/// cached photographs, prefetch buffers and undistortion maps. Decodes no photograph. @throws InputError if the
/// undistortion of a lens leaves no pixel, or a mask cannot be used
std::shared_ptr<SceneImages> prepare_images(std::vector<ViewSource>& sources, const SceneOptions& options);

/// The photograph of a view. Thread-safe.
class ViewImage {
 public:
  /// Makes an image that exists only in memory.
  explicit ViewImage(Image8 image);
  /// Makes a photograph on disk.
  ViewImage(ViewSource source, std::shared_ptr<SceneImages> shared)
      : source_(std::move(source)), shared_(std::move(shared)) {}

  ImageSize size() const { return source_.size; }  // px
  std::int64_t n_bytes() const { return std::int64_t{3} * size().width * size().height; }
  /// Returns the group, or -1. Reading the images of one group together avoids building its undistortion map more than
  /// once.
  int lens_group() const { return source_.lens_group; }
  /// Returns the memory of the scene, or null for an image that exists only in memory.
  ImageMemory* memory() const { return shared_ ? &shared_->memory : nullptr; }

  /// Returns the image if it is in memory, or null.
  std::shared_ptr<const Image8> held() const { return std::atomic_load(&held_); }
  /// Returns the image from memory, or decodes it from disk, undistorts it and reduces it to size(). @throws InputError
  /// with the file's name if it is missing or damaged, or its size has changed since the scene was loaded
  std::shared_ptr<const Image8> read() const;
  /// Does the same, but writes to n_bytes() bytes, as RGB in row-major order.
  void read_into(std::uint8_t* rgb) const;

  /// Returns the photograph's alpha channel, undistorted and of size(), or nothing if it has none. @throws InputError
  /// as read()
  std::optional<Image8> read_alpha() const;

  /// Reads a depth map that belongs to this photograph. It is undistorted like it, and has size(). The file may have
  /// any size with the photograph's aspect ratio. @throws InputError with the file's name if it cannot be used
  Depth16 read_depth(const std::filesystem::path& file) const;

  /// Keeps the image in memory, which the caller has reserved (ImageMemory::try_hold).
  void hold(std::shared_ptr<const Image8> image) { std::atomic_store(&held_, std::move(image)); }

 private:
  void decode_into(std::uint8_t* rgb) const;
  /// Returns the photograph from disk, turned upright.
  Image8 decode() const;

  ViewSource source_;
  std::shared_ptr<SceneImages> shared_;
  std::shared_ptr<const Image8> held_;
};

/// Loads the photographs of `views` into memory with all threads, in the order of the views, as far as ImageMemory
/// allows. @throws InputError for the first one that cannot be read
void hold_images(const std::vector<View>& views, const ProgressFn& progress);

}  // namespace b3dgs
