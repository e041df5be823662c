// By how much a rendered view differs from its photograph, pixel by pixel: which Gaussians are blended into large
// errors (Rasterizer::score()).
#pragma once

#include <torch/types.h>

namespace b3dgs {

/// Reuses its memory from view to view.
class ErrorImage {
 public:
  /// Mean over the channels of |rendered - truth|, within [0, 1], squared; 0 at invalid pixels. Tensors
  /// as in ImageLoss::compute(). Asynchronous on a GPU.
  void compute(const torch::Tensor& rendered, const torch::Tensor& truth, const torch::Tensor& valid);

  /// [H, W] of the last compute(), valid until the next one.
  const torch::Tensor& error() const { return error_; }

 private:
  torch::Tensor error_, room_;
};

}  // namespace b3dgs
