// Turns photographs of a distorted camera into those of a pinhole camera, the only one that the rasterizer supports.
#pragma once

#include <cstdint>
#include <memory>
#include <vector>

#include "scene/cameras/lens.h"
#include "scene/images/image.h"

namespace b3dgs {

/// Maps images of one lens and size to the pinhole with the same focal lengths, principal point and size. Pixels
/// outside the photograph become black and invalid. Immutable, so threads may share it.
class Undistorter {
 public:
  /// `lens` is in pixels of an image of this size. @throws InputError, beginning with `place`, if the image is too
  /// large or no pixel is valid
  Undistorter(const Lens& lens, int width, int height, const std::string& place);

  /// Bilinear, as in COLMAP's undistorter: sharper filters ring at edges.
  Image8 apply(const Image8& image) const;
  /// The same, written to 3 x width x height bytes.
  void apply_into(const Image8& image, std::uint8_t* rgb) const;

  /// The same for a depth map. Values at invalid pixels have no meaning.
  Depth16 apply(const Depth16& map) const;

  /// The same for a mask of one channel, 0 or 255: values between where both meet, 0 at invalid pixels.
  Image8 apply_to_mask(const Image8& mask) const;

  /// Mask of one channel: 255 where an output pixel comes from inside the photograph; null if all do.
  const std::shared_ptr<const Image8>& valid() const { return valid_; }
  double valid_share() const { return valid_share_; }  // in (0, 1]

 private:
  int width_, height_;
  std::vector<float> source_;  // [height, width, 2] px in OpenCV's convention: pixel centres at integers
  std::shared_ptr<const Image8> valid_;
  double valid_share_ = 1;
};

/// A mask for a smaller image: a pixel is valid only if all pixels that it covers are.
Image8 shrink_mask(const Image8& mask, int width, int height);

}  // namespace b3dgs
