// Rendering inverse depth, the sum of weight over camera-space z (RenderSettings::inverse_depth). Binning orders splats
// by their depth; after it, the depth of each splat is replaced by its inverse, which the blend sums like a depth. The
// backward blend then gives the gradient with respect to the inverse. So every kernel renders inverse depth, and none
// has code for it.
#pragma once

#include "raster/args.h"

namespace b3dgs {

B3DGS_HD void invert_depth(Splat& splat) {
  splat.depth = 1.0f / splat.depth;
}

/// Gradient with respect to the depth z of a splat whose `depth` is 1 / z, from that with respect to 1 / z.
B3DGS_HD float depth_gradient(const Splat& splat, float grad_inverse) {
  return -(splat.depth * splat.depth) * grad_inverse;
}

}  // namespace b3dgs
