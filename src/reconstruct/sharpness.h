// How sharp an image is.
#pragma once

#include <cstdint>

namespace b3dgs {

/// Variance of the Laplacian of a grey image, [height, width] bytes: larger where edges are sharper. For comparing
/// frames of one video that show about the same.
double sharpness(const std::uint8_t* grey, int width, int height);

}  // namespace b3dgs
