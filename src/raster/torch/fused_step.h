// For training on a GPU: the forward and backward pass split so that a kernel of the optimizer can take over where
// storing intermediate results would only cost memory traffic. The one header of this folder with CUDA types; they are
// declared in raster/cuda/passes.h.
#pragma once

#include "raster/torch/rasterizer.h"

namespace b3dgs {

namespace cuda {
class ColorPass;
struct ProjectBackwardCudaArgs;
}  // namespace cuda

/// Passes of `rasterizer`, whose device must be a GPU and which must outlive this object.
class FusedStep {
 public:
  explicit FusedStep(Rasterizer& rasterizer) : rasterizer_(rasterizer) {}

  /// Rasterizer::forward(), with colours computed by `colors` (null: by the rasterizer).
  RenderedView forward(const GaussianTensors& gaussians, const PinholeView& view, const RenderSettings& settings,
                       cuda::ColorPass* colors);

  /// Rasterizer::project(), with colours computed by `colors` (null: by the rasterizer).
  ViewSplats project(const GaussianTensors& gaussians, const PinholeView& view, const RenderSettings& settings,
                     cuda::ColorPass* colors);

  /// Rasterizer::project_views(), likewise.
  std::vector<ViewSplats> project_views(const GaussianTensors& gaussians, const std::vector<PinholeView>& views,
                                        const std::vector<RenderSettings>& settings, cuda::ColorPass* colors);

  /// The blending half of Rasterizer::backward(). `rest` receives the arguments of the other half, the backward
  /// projection, for a kernel that uses each Gaussian's gradient without storing it. Its only gradient array is
  /// means2d, the one in the returned statistics, which that kernel must write. @throws LogicError before any forward()
  ViewStatistics backward_blend(const GaussianTensors& gaussians, const RenderedViewGrad& grad,
                                cuda::ProjectBackwardCudaArgs& rest);

 private:
  Rasterizer& rasterizer_;
};

}  // namespace b3dgs
