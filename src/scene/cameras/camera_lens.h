// Lenses, for undistortion and for cameras that keep their lens. The formulas are in raster/math/lens.h.
#pragma once

#include <array>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "scene/cameras/camera.h"
#include "scene/images/image.h"

namespace b3dgs {

/// Returns the distorted point of an undistorted one, on the plane z = 1 in front of the camera. Not for panoramas.
std::array<double, 2> distort(const LensParams<double>& lens, double x, double y);

/// Returns the largest undistorted radius up to `limit` below which the distorted radius grows. The polynomial was
/// fitted only to the photograph. Beyond this radius it maps points outside the field of view back into the photograph.
double monotonic_radius(LensParams<double> lens, double limit);

/// Makes an equirectangular camera for an image of this size, at the origin.
Camera panorama_camera(ImageSize size);

/// Returns the camera for photographs that are trained with their lens. Sets the largest angle of the lens, which is a
/// little beyond the corners of the image, or where the formula of the lens folds over. @throws InputError, beginning
/// with `place`, if no pixel of the image is within this angle
Camera native_camera(Camera camera, const std::string& place);

/// Directions of the light at pixels.
class LensRays {
 public:
  explicit LensRays(const Camera& camera);

  /// Returns a unit vector in camera coordinates, or nothing if this position (px) shows no direction.
  std::optional<std::array<double, 3>> at(double x, double y) const;

 private:
  static constexpr int kSteps = 256;
  Camera camera_;
  std::array<double, kSteps + 1> radii_{};  // on the plane of the distorted point, at steps of the angle to the axis
};

/// Returns a mask of one channel that is 255 where a pixel shows a direction. Within 4 degrees of a panorama's poles,
/// where tripods and stitching are, it is 0. Returns null if all pixels are valid.
std::shared_ptr<const Image8> lens_mask(const Camera& camera);

/// Returns pinhole cameras at the same place that together see what the camera sees: the camera itself, one pinhole, or
/// up to six faces of a cube, each of 90 degrees and a margin.
std::vector<Camera> pinhole_faces(const Camera& camera);

/// Warps an image of camera `from` into camera `to`, which stands at the same place (bilinear). `valid`, of one
/// channel, is 255 where `from` shows the pixel. Elsewhere the result is black.
struct Warped {
  Image8 image, valid;
};
Warped warp_image(const Image8& image, const Camera& from, const Camera& to);

/// Returns approximately the share of the photograph's pixels that its undistorted image would show.
double undistorted_share(const Camera& camera);

}  // namespace b3dgs
