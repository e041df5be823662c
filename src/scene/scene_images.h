// The photographs of a scene before they are decoded: where each comes from, and what they share.
#pragma once

#include <cstdint>
#include <filesystem>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "scene/cameras/camera.h"
#include "scene/cameras/lens.h"
#include "scene/cameras/undistort.h"
#include "scene/images/image.h"
#include "scene/images/image_memory.h"

namespace b3dgs {

struct SceneOptions;

/// What is known of a view before its photograph is decoded.
struct ViewSource {
  std::string name;  // in the model
  std::filesystem::path file;
  std::filesystem::path mask;  // empty: none
  std::uint32_t image_id = 0, camera_id = 0;
  std::string camera_place;             // "FILE: camera ID", for errors
  Lens lens;                            // in pixels of the file
  ImageSize file_size, size;            // px, on disk and for training; `size` is not larger
  Camera camera;                        // pinhole of `size`, with its pose
  int lens_group = -1;                  // of SceneImages::undistorters; -1: the lens is a pinhole
  std::shared_ptr<const Image8> valid;  // mask of `size`; null: all pixels are valid
  std::shared_ptr<const Image8> empty;  // View::empty
  bool is_masked_out = false;           // no pixel is valid

  bool is_reduced() const { return size != file_size; }
};

/// What the photographs of a scene share.
struct SceneImages {
  SceneImages(const ImageMemory::Plan& plan, std::unique_ptr<UndistorterCache> undistorters, bool white_background)
      : memory(plan), undistorters(std::move(undistorters)), white_background(white_background) {}

  ImageMemory memory;
  const std::unique_ptr<UndistorterCache> undistorters;
  const bool white_background;  // what RGBA images are composited on
};

/// Assigns the sources their lens groups and masks, which it reads with all threads, and divides the host memory
/// between cached photographs, prefetch buffers and undistortion maps. Decodes no photograph. @throws InputError if the
/// undistortion of a lens leaves no pixel, or a mask cannot be used
std::shared_ptr<SceneImages> prepare_images(std::vector<ViewSource>& sources, const SceneOptions& options);

}  // namespace b3dgs
