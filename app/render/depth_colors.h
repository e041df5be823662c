// Depth as pictures: inverse depth, so that near things keep their contrast, over one range for all frames of a path,
// so that a video does not flicker; in the turbo colours, near red and far blue, fading to black where nothing is seen.
#pragma once

#include <torch/types.h>

#include <vector>

#include "model/formats/splat_cloud.h"
#include "scene/cameras/camera.h"
#include "scene/images/image.h"

namespace b3dgs {

/// World units.
struct DepthRange {
  double near = 0, far = 0;
};

/// Depths between which nearly all Gaussians lie that the cameras see: from the 2nd to the 98th percentile.
DepthRange visible_depth_range(const SplatCloud& splats, const std::vector<Camera>& cameras, double near_plane);

/// `depth` [H, W] is the sum of weight times depth, as it is rendered; `alpha` [H, W] divides it.
Image8 color_depth(const torch::Tensor& depth, const torch::Tensor& alpha, const DepthRange& range);

}  // namespace b3dgs
