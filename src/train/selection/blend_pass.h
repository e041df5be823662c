// A blend that can be run on one view with any of its kernels, to compare and time them.
#pragma once

#include <memory>
#include <string>
#include <vector>

#include "raster/torch/rasterizer.h"

namespace b3dgs {

/// What blends are measured on.
struct BlendInput {
  Rasterizer& rasterizer;
  const GaussianTensors& gaussians;
  RenderSettings settings;         // of the training's steps
  std::vector<PinholeView> views;  // that will be trained next
};

class BlendPass {
 public:
  virtual ~BlendPass() = default;
  /// Everything before the blend, and a first blend. @throws NumericError
  virtual void prepare(const PinholeView& view) = 0;
  virtual void run(const std::string& kernel) = 0;
  /// Keeps what the last run() computed.
  virtual void keep() = 0;
  /// Of the last run() against that: why it cannot stand for it, or "".
  virtual std::string fault() const = 0;
};

/// `input` must outlive the pass.
std::unique_ptr<BlendPass> make_forward_blend(const BlendInput& input);
std::unique_ptr<BlendPass> make_backward_blend(const BlendInput& input);

}  // namespace b3dgs
