// Coarse-to-fine training (--coarse_scale). Views grow from reduced to full size, as in DashGaussian (Chen et al. 2025,
// arXiv 2503.18402), but with a schedule that does not depend on the content of the photographs.
#pragma once

#include <cstdint>

#include "config/train_config.h"

namespace b3dgs {

/// Returns the scale s in `iteration` (counted from 1). A view of W x H pixels is trained at W / s x H / s, rounded
/// down. The fraction of pixels grows linearly from 1 / coarse_scale^2 to 1 at coarse_until, and s = 1 / sqrt(fraction)
/// is rounded down to an integer. So full size is reached once the fraction exceeds 1/4. The scale changes only after a
/// multiple of densification_interval, so that the statistics of a density control round come from views of one size.
inline int coarse_scale_at(const TrainConfig& config, int iteration) {
  const std::int64_t largest = config.coarse_scale, until = config.coarse_until;
  const std::int64_t last_round = std::int64_t{iteration - 1} / config.densification_interval;
  const std::int64_t done = last_round * config.densification_interval;
  if (largest <= 1 || done >= until) return 1;
  // The largest s with 1 / s^2 >= 1 / S^2 + (1 - 1 / S^2) done / until, in integer arithmetic.
  const std::int64_t squared = largest * largest, share = until + (squared - 1) * done;
  std::int64_t scale = largest;
  while (scale > 1 && scale * scale * share > squared * until) --scale;
  return static_cast<int>(scale);
}

/// Returns `scale`, reduced for small views so that the shorter side keeps at least 16 pixels, or the view its full
/// size.
inline int coarse_scale_of(int scale, int width, int height) {
  constexpr int kMinSide = 16;  // px; SSIM has a window of 11
  const int side = width < height ? width : height;
  while (scale > 1 && side / scale < kMinSide) --scale;
  return scale;
}

}  // namespace b3dgs
