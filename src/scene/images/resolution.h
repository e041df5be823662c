// The size that a photograph is trained at: the rules of -r and of a missing images_N folder; aspect ratios.
#pragma once

#include "scene/images/image.h"

namespace b3dgs {

inline constexpr int kMaxDefaultWidth = 1600;  // px; largest width for -r -1
inline constexpr int kMinWidth = 32;           // px; smallest width that -r accepts

/// Size of the images in an images_N folder: each side divided by N and rounded to nearest, halves up.
ImageSize divided_size(ImageSize size, int divisor);

/// 1, 2, 4 and 8 divide each side, rounding to nearest, halves to even, as Python does; -1 limits the width to
/// kMaxDefaultWidth; other values are the target width, with the height rounded down. Never larger than `size`, never
/// smaller than 1 px.
ImageSize training_size(ImageSize size, int resolution);

/// @throws InputError unless `resolution` is -1, 1, 2, 4, 8 or at least kMinWidth: -r 3 is probably meant as a divisor
void check_resolution(int resolution);

/// Whether the sizes have one aspect ratio, up to the rounding of one side by less than a pixel of `size`.
bool has_same_aspect(ImageSize other, ImageSize size);

}  // namespace b3dgs
