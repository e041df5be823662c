// Rotates, scales and moves Gaussians, and removes unwanted ones.
#pragma once

#include <array>
#include <cstdint>
#include <functional>
#include <string>
#include <vector>

#include "model/formats/splat_formats.h"
#include "scene/georeference.h"

namespace b3dgs {

/// Unit quaternion w, x, y, z.
using UnitQuat = std::array<double, 4>;

/// Returns the shortest rotation that turns the direction `from` into `to`. Neither may be 0.
UnitQuat rotation_between(const std::array<double, 3>& from, const std::array<double, 3>& to);

/// Returns the opposite rotation.
UnitQuat inverse(const UnitQuat& rotation);

/// Rotates means, orientations and SH coefficients about the origin of the world. The Gaussians look the same from the
/// rotated viewpoint as before.
void rotate_splats(const UnitQuat& rotation, SplatCloud& cloud);

/// Returns the matrix [15, 15] that turns SH coefficients of degree 1 to 3, in the order of SplatCloud::shN, into those
/// of the rotated function. Degrees do not mix.
std::array<double, 225> sh_rotation(const UnitQuat& rotation);

/// Multiplies world coordinates, and with them the sizes of the Gaussians.
void scale_splats(double factor, SplatCloud& cloud);

/// Parses a factor, or "x0,y0,z0,x1,y1,z1,distance": two points and the true distance between them, which is divided by
/// that of their coordinates. @throws InputError for other texts, and if the factor is not positive and finite
double parse_scale(const std::string& text);

/// Turns the coordinates of a georeferenced scene into easting, northing and height (Georeference::to_utm()). Sizes of
/// Gaussians stay in metres of the scene, which differ by less than 0.1 % from those of the grid.
void move_to_utm(const Georeference& georeference, SplatCloud& cloud);

// Removal of Gaussians and SH coefficients.

/// Keeps the Gaussians for which keeps(row) is true, in their order. Returns the number of removed ones.
std::int64_t keep_if(const std::function<bool(std::size_t row)>& keeps, SplatCloud& cloud);

/// Keeps the `count` Gaussians with the highest scores (one for each Gaussian), in their order. Among equal scores, the
/// first ones are kept. Returns the number of removed ones.
std::int64_t keep_highest(const std::vector<double>& scores, std::int64_t count, SplatCloud& cloud);

/// Returns the opacity, from 0 to 1.
double opacity_of(const SplatCloud& cloud, std::size_t row);

/// Returns the opacity times the area of the largest of the ellipsoid's three cross-sections, up to a constant. This
/// estimates the contribution of a Gaussian to an image without views.
std::vector<double> opacity_times_area(const SplatCloud& cloud);

/// Removes the SH coefficients of higher degrees.
void limit_sh_degree(int degree, SplatCloud& cloud);

}  // namespace b3dgs
