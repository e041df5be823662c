// Colour images of depth: inverse depth, which preserves contrast at close range, in the turbo colour map, near red and
// far blue, fading to black with decreasing alpha.
#pragma once

#include <torch/types.h>

#include <vector>

#include "model/formats/splat_formats.h"
#include "scene/cameras/camera.h"
#include "scene/images/image.h"

namespace b3dgs {

/// World units.
struct DepthRange {
  double near = 0, far = 0;
};

/// The 2nd to 98th percentile of the depths of the Gaussians that the cameras see: one range for all frames of a path,
/// so that videos do not flicker.
DepthRange visible_depth_range(const SplatCloud& splats, const std::vector<Camera>& cameras, double near_plane);

/// The 2nd to 98th percentile of the depths of a rendered view, over its opaque pixels.
DepthRange depth_range(const torch::Tensor& depth, const torch::Tensor& alpha);

/// `depth` [H, W]: rendered depth, the sum of weight x depth in world units. `alpha` [H, W]: the sum of the weights.
Image8 color_depth(const torch::Tensor& depth, const torch::Tensor& alpha, const DepthRange& range);

}  // namespace b3dgs
