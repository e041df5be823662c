// The loss of a rendered view against its photograph: (1 - lambda) L1 + lambda (1 - SSIM), value and gradient in one
// go.
//
// SSIM has an 11 x 11 Gaussian window (sigma 1.5), C1 = 0.01^2, C2 = 0.03^2 and zero padding; it and L1 are means over
// pixels and channels. The rendered image is not clamped: a colour above 1 has to feel the pull back.
//
// Pixels that are not valid count as 0 in both images where a window reaches them, and otherwise for nothing: both
// means are over the valid pixels alone, and the gradient at the others is 0.
#pragma once

#include <torch/types.h>

#include <cstdint>
#include <memory>

#include "train/loss/loss_args.h"

namespace b3dgs {

namespace cpu {

/// Floats of workspace for an image; aligned to 64 bytes.
std::int64_t loss_workspace_size(std::int32_t width, std::int32_t height);

/// The same bits for any number of threads. With n_valid 0 all is 0.
LossValue compute_loss(const LossArgs& args);

}  // namespace cpu

/// Pixels that are not 0 in a mask [H, W].
std::int64_t count_valid(const std::uint8_t* valid, std::int64_t n_pixels);

/// The loss on tensors; keeps its buffers from step to step.
class ImageLoss {
 public:
  /// @throws InputError if this build has no loss for the device.
  explicit ImageLoss(torch::Device device);
  ~ImageLoss();

  /// Loss and gradient of `rendered` [H, W, 3] float against `truth` [H, W, 3] uint8, with `valid` [H, W] uint8 or
  /// undefined, of which n_valid pixels are not 0. Does not wait for a GPU.
  void compute(const torch::Tensor& rendered, const torch::Tensor& truth, const torch::Tensor& valid,
               std::int64_t n_valid, double lambda_dssim);

  /// Of the last compute(). Waits until a GPU is done with that, so a training step asks one step later.
  LossValue value() const;

  /// [H, W, 3] float, gradient of the last loss by the rendered image; valid until the next compute().
  const torch::Tensor& grad() const { return grad_; }

 private:
  struct OnCuda;
  torch::Device device_;
  torch::Tensor grad_, grad_room_, workspace_;
  LossValue value_;
  std::unique_ptr<OnCuda> cuda_;
};

}  // namespace b3dgs
