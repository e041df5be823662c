// Whether two kernels for one pass computed the same. Their arithmetic is one (raster/blend.h); the order of sums is
// not.
#pragma once

#include <string>

#include "raster/torch/rasterizer.h"

namespace b3dgs {

/// Why `image` cannot stand for `reference`, or "". Sums in another order differ by some 1e-5 of the image's range. At
/// a threshold that is enough for a splat to count in one and not in the other: 1/255 at the cutoff, 0.01 at the stop.
/// So nearly all pixels must agree to 1e-4, a few may be off by 0.02, of the range (at least 1); what is not finite
/// never agrees.
std::string image_fault(const RenderedView& image, const RenderedView& reference);

/// Why the gradients `sums` [M, K] cannot stand for `reference`, or "": each of the K columns has to agree to 1e-3 of
/// its norm. Single rows say nothing, since they are differences of nearly equal sums where little light is left.
std::string gradient_fault(const torch::Tensor& sums, const torch::Tensor& reference);

}  // namespace b3dgs
