// The loss of a rendered view compared with its photograph, L1 and D-SSIM, value and gradient in one pass
// (loss_args.h).
//
// L1 and SSIM are means over the valid pixels and their channels. SSIM uses zero padding. Where a window covers invalid
// pixels, these are 0 in both images, and their gradient is 0. The rendered image is not clamped, because a colour
// above 1 needs a gradient that lowers it.
#pragma once

#include <torch/types.h>

#include <cstdint>
#include <optional>

#include "config/train_config.h"
#include "raster/torch/rasterizer.h"
#include "raster/torch/torch_cuda.h"
#include "train/loss/loss_args.h"

namespace b3dgs {

/// Returns the weights of the loss terms that follow from the options.
inline LossWeights loss_weights(const TrainConfig& config) {
  return {config.lambda_dssim, config.mask_mode == MaskMode::kSegment ? 1.0 : 0.0};
}

namespace cpu {

/// Returns the size of the workspace for an image in floats. The workspace must be aligned to 64 bytes.
std::int64_t loss_workspace_size(std::int32_t width, std::int32_t height);

/// Computes the loss and, if args.grad is set, its gradient. The result does not depend on the number of threads. With
/// n_valid = 0, value and gradient are 0.
LossValue compute_loss(const LossArgs& args);

}  // namespace cpu

/// Returns the number of nonzero pixels of a mask [H, W].
std::int64_t count_valid(const std::uint8_t* valid, std::int64_t n_pixels);

/// Computes the loss on tensors. Buffers are reused from step to step.
class ImageLoss {
 public:
  explicit ImageLoss(torch::Device device);

  /// Computes loss and gradient of `rendered` [H, W, 3] float compared with `truth` [H, W, 3] uint8. `valid` is [H, W]
  /// uint8 with n_valid nonzero pixels, or undefined if all are valid. Asynchronous on a GPU.
  void compute(const torch::Tensor& rendered, const torch::Tensor& truth, const torch::Tensor& valid,
               std::int64_t n_valid, const LossWeights& weights);

  /// Adds weight * (sum of alpha over the empty pixels) / (pixels of the image) to the loss of the last compute(), so
  /// that empty pixels become transparent. `alpha` is [H, W] float, and `empty` [H, W] uint8 is 255 or 0. Asynchronous
  /// on a GPU.
  void add_alpha(const torch::Tensor& alpha, const torch::Tensor& empty, double weight);

  /// Returns the loss of the last compute(). Waits for the GPU, so a training step reads it one step later.
  LossValue value() const;

  /// GPU memory per pixel of the largest image.
  static constexpr std::int64_t kBytesPerPixel = (3 + 9) * sizeof(float);  // gradient, workspace

  /// Returns the gradient of the last loss with respect to the rendered view, valid until the next compute(). It has
  /// color [H, W, 3] and, after add_alpha(), alpha [H, W]. No term depends on depth.
  RenderedViewGrad grad() const { return {grad_, {}, alpha_grad_}; }

 private:
  torch::Device device_;
  torch::Tensor grad_, grad_room_, workspace_;
  LossValue value_;                                           // on a CPU
  std::optional<HostCopy> host_value_;                        // on a GPU, contains a LossValue
  torch::Tensor alpha_grad_, alpha_grad_room_, alpha_value_;  // undefined without add_alpha()
};

/// Computes the error of each pixel of a rendered view, with which Rasterizer::score() finds the Gaussians that
/// contribute to large errors. Memory is reused from view to view.
class ErrorImage {
 public:
  /// Computes the errors (write_pixel_error()). Tensors as in ImageLoss::compute(). Asynchronous on a GPU.
  void compute(const torch::Tensor& rendered, const torch::Tensor& truth, const torch::Tensor& valid);

  /// Returns the errors of the last compute(), [H, W], valid until the next one.
  const torch::Tensor& error() const { return error_; }

 private:
  torch::Tensor error_, room_;
};

}  // namespace b3dgs
