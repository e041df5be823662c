// An affine transform of colours, fitted to a photograph: what remains after it is not due to exposure or white
// balance.
#pragma once

#include <torch/types.h>

#include <array>

#include "scene/images/image.h"

namespace b3dgs {

/// [3, 4]: colour' = transform (r, g, b, 1).
using ColorTransform = std::array<double, 12>;

inline constexpr ColorTransform kSameColors{1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0};

/// The transform of `rendered` [H, W, 3] that minimises the mean squared difference from `truth` over the pixels where
/// `valid` is not 0 (null = all), plus 1e-6 times its squared difference from kSameColors, which decides where colours
/// do not (an image of one colour, no valid pixel).
ColorTransform fit_colors(const torch::Tensor& rendered, const Image8& truth, const Image8* valid);

/// A transformed copy of `rendered` [H, W, 3].
torch::Tensor transform_colors(const torch::Tensor& rendered, const ColorTransform& transform);

/// The valid pixels in columns [begin, end): 255, others 0.
Image8 valid_in_columns(int width, int height, const Image8* valid, int begin, int end);

}  // namespace b3dgs
