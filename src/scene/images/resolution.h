// From the size of an image file to the size it is trained at: the rules of -r and of a missing images_N folder.
#pragma once

#include "scene/images/image_io.h"

namespace b3dgs {

inline constexpr int kMaxDefaultWidth = 1600;  // px; what -r -1 allows
inline constexpr int kMinWidth = 32;           // px; the smallest width that -r takes

/// Size that an images_N folder would have: each side divided by N and rounded to nearest, halves up.
ImageSize divided_size(ImageSize size, int divisor);

/// 1, 2, 4 and 8 divide, rounding to nearest, halves to even, as Python does; -1 caps the width at kMaxDefaultWidth;
/// other values are the target width, with the height truncated. Never larger than `size`, never below 1 px.
ImageSize training_size(ImageSize size, int resolution);

/// @throws InputError unless `resolution` is -1, 1, 2, 4, 8 or at least kMinWidth: who writes 3 means a third.
void check_resolution(int resolution);

}  // namespace b3dgs
