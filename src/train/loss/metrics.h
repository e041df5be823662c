// How good a picture is. As users of 3DGS know them: PSNR from the mean squared error over all pixels and channels in
// [0, 1], SSIM with an 11 x 11 Gaussian window (sigma 1.5, C1 = 0.01^2, C2 = 0.03^2, zero padding), mean over all.
#pragma once

#include <torch/types.h>

#include "model/evaluation.h"
#include "scene/images/image.h"

namespace b3dgs {

/// Compares a rendered image [H, W, 3] (clamped to [0, 1] here, and rounded to 8 bits as it would be saved) with the
/// truth. Pixels where `valid` is 0 count for nothing; null: all are valid.
ImageQuality image_quality(const torch::Tensor& rendered, const Image8& truth, const Image8* valid);

/// [H, W, 3] or [H, W] float in [0, 1] to 8 bits, clamped and rounded.
Image8 to_image8(const torch::Tensor& image);

}  // namespace b3dgs
