// Rotation of Gaussians about the origin.
#pragma once

#include <array>

#include "model/formats/splat_cloud.h"

namespace b3dgs {

/// Unit quaternion w, x, y, z.
using UnitQuat = std::array<double, 4>;

/// The shortest rotation that turns the direction `from` into `to`. Neither may be 0.
UnitQuat rotation_between(const std::array<double, 3>& from, const std::array<double, 3>& to);

/// The opposite rotation.
UnitQuat inverse(const UnitQuat& rotation);

/// Rotates means, orientations and SH coefficients about the origin of the world: the Gaussians look from the rotated
/// viewpoint as they did before.
void rotate_splats(const UnitQuat& rotation, SplatCloud& cloud);

/// The matrix [15, 15] that turns SH coefficients of degree 1 to 3, in the order of SplatCloud::shN, into those of the
/// rotated function. Degrees do not mix.
std::array<double, 225> sh_rotation(const UnitQuat& rotation);

}  // namespace b3dgs
