// The lens of one camera: intrinsics and distortion, from the ideal pinhole to the photograph.
#pragma once

#include <array>
#include <vector>

#include "scene/cameras/camera.h"
#include "scene/cameras/lens_models.h"
#include "scene/images/image.h"

namespace b3dgs {

struct Lens {
  double fx = 0, fy = 0, cx = 0, cy = 0;  // px; the centre of the upper left pixel is at (0.5, 0.5)
  const LensModel* model = &kPinholeLens;
  std::vector<double> coefficients = {};  // as many as the model has, in its order

  /// Whether photographs need no undistortion.
  bool is_pinhole() const;
  /// The same lens for an image of another size.
  Lens scaled(double sx, double sy) const;
  /// The camera of undistorted images of this size, without a pose: same focal lengths and principal point.
  Camera pinhole(ImageSize size) const;
};

/// Undistorted to distorted point, both on the plane z = 1.
std::array<double, 2> distort(const Lens& lens, double x, double y);

/// Largest undistorted radius up to `limit` below which the distorted radius grows. Beyond it the polynomial, which was
/// fitted to the photograph only, maps points outside the field of view back into the photograph.
double monotonic_radius(const Lens& lens, double limit);

}  // namespace b3dgs
