// Image quality as usual in 3DGS work: PSNR from the mean squared error over all pixels and channels in [0, 1]; SSIM
// with an 11 x 11 Gaussian window (sigma 1.5 px, C1 = 0.01^2, C2 = 0.03^2, zero padding), averaged over pixels and
// channels.
#pragma once

#include <torch/types.h>

#include <optional>

#include "model/evaluation.h"
#include "scene/images/image.h"

namespace b3dgs {

/// Compares a rendered image [H, W, 3] with the photograph; the image is clamped to [0, 1] and rounded to 8 bits first,
/// as it would be saved. Pixels where `valid` is 0 are ignored; null = all are valid. No value without valid pixels.
std::optional<ImageQuality> image_quality(const torch::Tensor& rendered, const Image8& truth, const Image8* valid);

/// Converts [H, W, 3] or [H, W] float in [0, 1] to 8 bits, clamped and rounded.
Image8 to_image8(const torch::Tensor& image);

}  // namespace b3dgs
