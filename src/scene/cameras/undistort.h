// Maps photographs of a distorted camera to those of a pinhole camera.
#pragma once

#include <cstdint>
#include <memory>
#include <mutex>
#include <string>
#include <vector>

#include "scene/cameras/camera.h"
#include "scene/images/image.h"

namespace b3dgs {

/// Maps images of one camera to the pinhole with the same focal lengths, principal point and size. Pixels outside the
/// photograph become black and invalid. Immutable, so threads may share it.
class Undistorter {
 public:
  /// @throws InputError, beginning with `place`, if the image is too large or no pixel is valid
  Undistorter(const Camera& camera, const std::string& place);

  /// Interpolates bilinearly, as COLMAP's undistorter does, because sharper filters ring at edges. It is used for
  /// photographs, masks and depth maps. Invalid pixels become 0. `pixels`: width x height x image.channels values.
  template <class Value>
  void apply_into(const Raster<Value>& image, Value* pixels) const;
  template <class Value>
  Raster<Value> apply(const Raster<Value>& image) const {
    Raster<Value> result(width_, height_, image.channels);
    apply_into(image, result.pixels.data());
    return result;
  }

  /// Returns a mask of one channel that is 255 where an output pixel comes from inside the photograph; null if all do.
  const std::shared_ptr<const Image8>& valid() const { return valid_; }

  /// Returns the angle to the axis, in radians, at which the formula of the lens folds over inside the result, or 0.
  double fold_angle() const { return fold_angle_; }

 private:
  int width_, height_;
  double fold_angle_ = 0;
  std::vector<float> source_;  // [height, width, 2] px in OpenCV's convention: pixel centres at integers
  std::shared_ptr<const Image8> valid_;
};

/// The undistorters of a scene. Each stores a map of eight bytes per pixel, so a scene with one camera per image would
/// need more memory for maps than for images. Therefore only the most recently used ones are cached, and the others are
/// built again. Threads may share the cache once all groups are added.
class UndistorterCache {
 public:
  /// Caches at most max_bytes. Maps that are still in use after they have left the cache are not counted.
  explicit UndistorterCache(std::int64_t max_bytes) : max_bytes_(max_bytes) {}

  /// Adds a group, the images of one camera, and returns its index. Errors begin with `place`.
  int add_group(const Camera& camera, const std::string& place);

  /// Returns the most bytes that the cache can use for these groups.
  std::int64_t most_kept_bytes() const;

  /// Returns the undistorter from the cache, or builds it. @throws InputError as the constructor of Undistorter
  std::shared_ptr<const Undistorter> get(int group);

 private:
  struct Group {
    Camera camera;
    std::string place;
    std::mutex build_mutex;                  // one thread builds the map, the others wait for it
    std::shared_ptr<const Undistorter> map;  // set for groups in kept_
  };

  const std::int64_t max_bytes_;
  std::vector<std::unique_ptr<Group>> groups_;
  std::mutex mutex_;
  std::vector<Group*> kept_;  // the last one is the most recently used
  std::int64_t kept_bytes_ = 0;
};

/// Reduces a mask. A pixel is valid only if all pixels that it covers are.
Image8 shrink_mask(const Image8& mask, int width, int height);

}  // namespace b3dgs
