// Backward pass and Adam together, for that is how a GPU does them.
#pragma once

#include "raster/rasterizer.h"
#include "raster/stages.h"
#include "train/adam.h"

namespace b3dgs {

struct GaussianStep {
  AdamRates rates{};
  StageRecorder* stages = nullptr;  // on a GPU the projection's backward pass is part of Stage::kOptimizer
};

/// Gradients of the view that `rasterizer` rendered last, and one step of Adam along them. `grads` is memory for the
/// gradients where they are stored at all: on the CPU. Does not wait for the device.
ViewStatistics step_gaussians(const GaussianStep& step, Rasterizer& rasterizer, const RenderedViewGrad& view_grad,
                              GaussianTensors& grads, GaussianTensors& gaussians, AdamState& state);

}  // namespace b3dgs
