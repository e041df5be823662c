// Whether two kernels of one pass computed the same result. They share their arithmetic (raster/math/blend.h), but not
// the order of sums.
#pragma once

#include <string>

#include "raster/torch/rasterizer.h"

namespace b3dgs {

/// How `image` disagrees with `reference`, or "". Sums in another order differ by about 1e-5 of the image's range. At a
/// threshold that is enough for a splat to contribute to one image and not to the other, which changes a pixel by up to
/// 1/255 (alpha cutoff) or 0.01 (transmittance stop). So nearly all pixels must agree to 1e-4 of the range (at least
/// 1), and a few to 0.02. Values that are not finite never agree.
std::string image_fault(const RenderedView& image, const RenderedView& reference);

/// How the gradients `sums` [M, K] disagree with `reference`, or "": each of the K columns must agree to 1e-3 of its
/// norm. Single rows are not compared: at low transmittance they are differences of nearly equal sums.
std::string gradient_fault(const torch::Tensor& sums, const torch::Tensor& reference);

}  // namespace b3dgs
