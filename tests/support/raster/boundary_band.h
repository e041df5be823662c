// Compares images with two tolerances. Two correct rasterizers may decide differently about a splat at the cutoff or
// cap or a pixel at the stop. The reference marks those pixels. There must be few of them, and they may differ by at
// most the effect of one decision. Other pixels must agree closely.
#pragma once

#include <algorithm>

#include "support/approx.h"

namespace b3dgs::test {

struct BandLimits {
  double tight = 1e-5;         // unmarked pixels, for values up to 1
  double flipped = 0.011;      // marked pixels: one decision changes 1/255 at the cutoff, 0.01 at the stop
  double marked_share = 0.01;  // largest fraction of marked pixels
};

/// Returns whether an image ([H, W] or [H, W, 3]) agrees with the reference. `marked` [H, W] are the pixels near a
/// decision. Tolerances are multiplied by `scale`, the largest value that one splat can add: its colour or its depth.
inline testing::AssertionResult images_agree(const torch::Tensor& actual, const torch::Tensor& expected,
                                             const torch::Tensor& marked, double scale, const BandLimits& limits = {}) {
  const std::int64_t n_marked = marked.sum().item<std::int64_t>();
  const double most = std::max(2.0, limits.marked_share * static_cast<double>(marked.numel()));
  if (static_cast<double>(n_marked) > most) {
    return testing::AssertionFailure() << n_marked << " of " << marked.numel() << " pixels are near a decision";
  }
  torch::Tensor allowed = torch::where(marked, torch::full({}, limits.flipped * scale, torch::kFloat64),
                                       torch::full({}, limits.tight * scale, torch::kFloat64));
  if (expected.dim() == 3) allowed = allowed.unsqueeze(2);
  return within(actual, expected, allowed);
}

}  // namespace b3dgs::test
