// Comparison of images in two tiers. A splat at the cutoff or cap, or a pixel at the stop, may be decided either way by
// two correct rasterizers; the reference marks those pixels. Elsewhere images agree tightly. Marked pixels have to be
// few, and may differ by what one decision can change, no more.
#pragma once

#include <algorithm>

#include "support/approx.h"

namespace b3dgs::test {

struct BandLimits {
  double tight = 1e-5;     // where no decision is in doubt, for values up to 1
  double flipped = 0.011;  // one decision: 1/255 at the cutoff, 0.99 to stop 0.01 before the end, for values up to 1
  double marked_share = 0.01;  // of the pixels at most
};

/// Whether an image ([H, W] or [H, W, 3]) agrees with the reference, `marked` being the latter's doubtful pixels [H,
/// W]. Limits scale with the largest value that a splat can bring, `scale`: its colour, or its depth.
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
