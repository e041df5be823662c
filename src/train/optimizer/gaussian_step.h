// Forward pass, backward pass and Adam behind one interface, because a GPU fuses parts of them.
#pragma once

#include <memory>

#include "raster/stages.h"
#include "raster/torch/rasterizer.h"
#include "train/optimizer/adam.h"
#include "train/optimizer/regularization.h"

namespace b3dgs {

/// Adam steps, each along the gradients of one view. On a GPU, updates of SH coefficients beyond degree 0 are deferred
/// until a view sees the Gaussian (deferred_sh.h): call flush() before these coefficients or their moments are read,
/// and before any tensor is replaced.
class GaussianStepper {
 public:
  /// `rasterizer` must outlive this.
  explicit GaussianStepper(Rasterizer& rasterizer);
  ~GaussianStepper();

  /// Rasterizer::forward() for a training step.
  RenderedView forward(GaussianTensors& gaussians, AdamState& state, const PinholeView& view, RenderSettings settings);

  /// Gradients of that view and of the regularisation, and one step along them. `stages` (may be null) records the
  /// optimizer stage, which on a GPU includes the projection's backward pass. Asynchronous on a GPU.
  ViewStatistics step(const AdamRates& rates, const RenderedViewGrad& view_grad, GaussianTensors& gaussians,
                      AdamState& state, StageRecorder* stages, const RegularizationWeights& regularization = {});

  /// Applies all deferred updates. Asynchronous on a GPU.
  void flush(GaussianTensors& gaussians, AdamState& state);

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace b3dgs
