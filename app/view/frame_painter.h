// Renders a frame of the live view and gives it the colours of its mode.
#pragma once

#include <torch/types.h>

#include "raster/torch/rasterizer.h"
#include "view/frame_source.h"

namespace b3dgs {

class FramePainter {
 public:
  /// `unit`: world units per unit of the Gaussians' frame, for legends.
  FramePainter(torch::Device device, double unit) : rasterizer_(device), unit_(unit) {}

  /// Fills the image, the legend and the time.
  /// @throws InvalidGaussianError naming the first Gaussian that cannot be rendered
  Frame paint(const FrameRequest& request, const GaussianTensors& gaussians, RenderSettings settings);

 private:
  Rasterizer rasterizer_;  // its own, so that a training's keeps what it needs
  double unit_;
};

}  // namespace b3dgs
