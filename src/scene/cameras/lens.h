// The formulas of lenses on the plane z = 1 in front of the camera, for undistortion; raster/math/lens.h has them for
// rendering, of 3D points, with derivatives.
#pragma once

#include <array>

#include "raster/view_lens.h"

namespace b3dgs {

/// From the undistorted point to the distorted one. A panorama has no place on this plane: it counts as a pinhole.
std::array<double, 2> distort(const LensParams<double>& lens, double x, double y);

/// Largest undistorted radius up to `limit` below which the distorted radius grows. Beyond it the polynomial, which was
/// fitted to the photograph only, maps points outside the field of view back into the photograph.
double monotonic_radius(const LensParams<double>& lens, double limit);

}  // namespace b3dgs
