// Forward pass, backward pass and Adam together, for that is how a GPU does them.
#pragma once

#include <memory>

#include "raster/stages.h"
#include "raster/torch/rasterizer.h"
#include "train/optimizer/adam.h"

namespace b3dgs {

/// Steps of Adam along the gradients of one view each. On a GPU harmonics' steps are put off until a view sees the
/// Gaussian (cuda/deferred_harmonics.h): between forward() and settle() they and their moments are not to be read, nor
/// may the tensors be replaced.
class GaussianStepper {
 public:
  /// Renders with `rasterizer`, which has to outlive this.
  explicit GaussianStepper(Rasterizer& rasterizer);
  ~GaussianStepper();

  /// Rasterizer::forward() for a step.
  RenderedView forward(GaussianTensors& gaussians, AdamState& state, const PinholeView& view, RenderSettings settings);

  /// Gradients of that view, and one step along them. `stages` is told of the optimizer, which on a GPU includes the
  /// projection's backward pass; null: nobody asks. Does not wait for the device.
  ViewStatistics step(const AdamRates& rates, const RenderedViewGrad& view_grad, GaussianTensors& gaussians,
                      AdamState& state, StageRecorder* stages);

  /// Takes what steps were put off. Does not wait for the device.
  void settle(GaussianTensors& gaussians, AdamState& state);

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace b3dgs
