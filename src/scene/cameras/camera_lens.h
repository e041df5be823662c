// Lenses, for undistortion and for cameras that keep theirs instead of an undistorted pinhole. The formulas are those
// of raster/math/lens.h.
#pragma once

#include <array>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "scene/cameras/camera.h"
#include "scene/images/image.h"

namespace b3dgs {

/// From the undistorted to the distorted point, on the plane z = 1 in front of the camera. Not for panoramas.
std::array<double, 2> distort(const LensParams<double>& lens, double x, double y);

/// Largest undistorted radius up to `limit` below which the distorted radius grows. Beyond it the polynomial, which was
/// fitted to the photograph only, maps points outside the field of view back into the photograph.
double monotonic_radius(LensParams<double> lens, double limit);

/// Of a panorama of this size, without a pose.
Camera panorama_camera(ImageSize size);

/// The camera of photographs that are trained as they are: with the largest angle of its lens, which is a little beyond
/// the corners of the image, or where the lens's formula folds over. @throws InputError, beginning with `place`, if no
/// pixel of the image is within it
Camera native_camera(Camera camera, const std::string& place);

/// Directions of the light that pixels show.
class LensRays {
 public:
  explicit LensRays(const Camera& camera);

  /// Unit vector in camera coordinates; nothing if no direction is shown at this place, px.
  std::optional<std::array<double, 3>> at(double x, double y) const;

 private:
  static constexpr int kSteps = 256;
  Camera camera_;
  std::array<double, kSteps + 1> radii_{};  // on the plane of the distorted point, at steps of the angle to the axis
};

/// Mask of one channel: 255 where a pixel shows a direction, and not within 4 degrees of a panorama's poles, where
/// tripods and stitching are; null if all do.
std::shared_ptr<const Image8> lens_mask(const Camera& camera);

/// Pinhole cameras of the same place that together see what the camera sees: itself, one, or up to six faces of a cube,
/// of 90 degrees and a margin.
std::vector<Camera> pinhole_faces(const Camera& camera);

/// What camera `to` would show of the image of camera `from` at the same place; bilinear. `valid`, of one channel, is
/// 255 where `from` shows it; elsewhere the result is black.
struct Warped {
  Image8 image, valid;
};
Warped warp_image(const Image8& image, const Camera& from, const Camera& to);

/// The share of the photograph's pixels that its undistorted image would show, about.
double undistorted_share(const Camera& camera);

}  // namespace b3dgs
