// The loss of a rendered view against its photograph, value and gradient in one pass: L1 and D-SSIM (loss_args.h).
//
// L1 and SSIM are means over the valid pixels and their channels. SSIM has zero padding, and invalid pixels are 0 in
// both images where a window covers them; the gradient there is 0. The rendered image is not clamped: a colour above 1
// needs a gradient that lowers it.
#pragma once

#include <torch/types.h>

#include <cstdint>
#include <optional>

#include "config/train_config.h"
#include "raster/torch/rasterizer.h"
#include "raster/torch/torch_cuda.h"
#include "train/loss/loss_args.h"

namespace b3dgs {

/// The options that weight the terms of the loss.
inline LossWeights loss_weights(const TrainConfig& config) {
  return {config.lambda_dssim, config.mask_mode == MaskMode::kSegment ? 1.0 : 0.0};
}

namespace cpu {

/// Floats of workspace for an image; aligned to 64 bytes.
std::int64_t loss_workspace_size(std::int32_t width, std::int32_t height);

/// The result does not depend on the number of threads. With n_valid = 0 value and gradient are 0.
LossValue compute_loss(const LossArgs& args);

}  // namespace cpu

/// Number of nonzero pixels of a mask [H, W].
std::int64_t count_valid(const std::uint8_t* valid, std::int64_t n_pixels);

/// The loss on tensors. Reuses its buffers from step to step.
class ImageLoss {
 public:
  explicit ImageLoss(torch::Device device);

  /// Loss and gradient of `rendered` [H, W, 3] float against `truth` [H, W, 3] uint8. `valid` is [H, W] uint8 with
  /// n_valid nonzero pixels, or undefined if all are valid. Asynchronous on a GPU.
  void compute(const torch::Tensor& rendered, const torch::Tensor& truth, const torch::Tensor& valid,
               std::int64_t n_valid, const LossWeights& weights);

  /// Adds weight * (sum of alpha over the empty pixels) / (pixels of the image) to the loss of the last compute(), so
  /// that nothing remains there: `alpha` is [H, W] float, `empty` [H, W] uint8, 255 or 0. Asynchronous on a GPU.
  void add_alpha(const torch::Tensor& alpha, const torch::Tensor& empty, double weight);

  /// Of the last compute(), for which this waits on a GPU: a training step reads it one step later.
  LossValue value() const;

  /// Memory on a GPU for each pixel of the largest image.
  static constexpr std::int64_t kBytesPerPixel = (3 + 9) * sizeof(float);  // gradient, workspace

  /// Gradient of the last loss with respect to the rendered view, valid until the next compute(). color [H, W, 3] is
  /// set, and alpha [H, W] after add_alpha(): no term depends on depth.
  RenderedViewGrad grad() const { return {grad_, {}, alpha_grad_}; }

 private:
  torch::Device device_;
  torch::Tensor grad_, grad_room_, workspace_;
  LossValue value_;                                           // on a CPU
  std::optional<HostCopy> host_value_;                        // on a GPU: a LossValue
  torch::Tensor alpha_grad_, alpha_grad_room_, alpha_value_;  // undefined without add_alpha()
};

/// By how much a rendered view differs from its photograph, pixel by pixel: which Gaussians are blended into large
/// errors (Rasterizer::score()). Reuses its memory from view to view.
class ErrorImage {
 public:
  /// write_pixel_error(); tensors as in ImageLoss::compute(). Asynchronous on a GPU.
  void compute(const torch::Tensor& rendered, const torch::Tensor& truth, const torch::Tensor& valid);

  /// [H, W] of the last compute(), valid until the next one.
  const torch::Tensor& error() const { return error_; }

 private:
  torch::Tensor error_, room_;
};

}  // namespace b3dgs
