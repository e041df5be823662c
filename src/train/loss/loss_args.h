// Inputs and outputs of the loss, without torch, shared by the CPU and the CUDA kernels.
#pragma once

#include <cstdint>

#include "core/vec.h"

namespace b3dgs {

/// Weights of the loss (Kerbl et al. 2023, equation 7):
///   loss = (1 - dssim) L1 + dssim (1 - SSIM)
struct LossWeights {
  double dssim = 0;  // in [0, 1]
  double alpha = 0;  // weight of the alpha of empty pixels, see ImageLoss::add_alpha()
};

/// Arguments of compute_loss(). All arrays are on one device and contiguous.
struct LossArgs {
  std::int32_t width = 0, height = 0;   // px
  const float* rendered = nullptr;      // [H, W, 3]
  const std::uint8_t* truth = nullptr;  // [H, W, 3]
  const std::uint8_t* valid = nullptr;  // [H, W] 0 = pixel is ignored; null = all count
  std::int64_t n_valid = 0;             // number of pixels that count
  LossWeights weights{};
  float* grad = nullptr;       // [H, W, 3] out, dL/d(rendered); null, on the CPU only: not computed
  float* workspace = nullptr;  // loss_workspace_size() floats
};

struct LossValue {
  double loss = 0;
  double l1 = 0;    // mean over valid pixels and channels
  double ssim = 0;  // mean over valid pixels and channels
};

/// Returns the loss, given the means of its terms.
B3DGS_HD LossValue weighted_loss(const LossWeights& weights, double l1, double ssim) {
  return {(1 - weights.dssim) * l1 + weights.dssim * (1 - ssim), l1, ssim};
}

/// Factors that turn the derivative of each term at one value (a channel of a pixel) into dL/d(rendered).
struct LossScales {
  float l1 = 0, ssim = 0;
};

B3DGS_HD LossScales loss_scales(const LossArgs& args) {
  const float per_value = 1.0f / (3.0f * static_cast<float>(args.n_valid));
  return {static_cast<float>(1 - args.weights.dssim) * per_value, -static_cast<float>(args.weights.dssim) * per_value};
}

/// Arguments of write_pixel_error(). All arrays are on one device and contiguous.
struct ErrorImageArgs {
  const float* rendered = nullptr;      // [H, W, 3]
  const std::uint8_t* truth = nullptr;  // [H, W, 3]
  const std::uint8_t* valid = nullptr;  // [H, W] 0 = invalid; null = all are valid
  float* error = nullptr;               // [H, W] out
};

/// Writes the square of the mean over the channels of |rendered - truth|, limited to 1. It is 0 if the pixel is
/// invalid.
B3DGS_HD void write_pixel_error(const ErrorImageArgs& args, std::int64_t pixel) {
  args.error[pixel] = 0;
  if (args.valid != nullptr && args.valid[pixel] == 0) return;
  float sum = 0;
  for (std::int64_t i = 3 * pixel; i < 3 * pixel + 3; ++i) {
    const float difference = args.rendered[i] - static_cast<float>(args.truth[i]) * (1.0f / 255.0f);
    sum += difference < 0 ? -difference : difference;
  }
  const float mean = sum * (1.0f / 3.0f);
  const float error = mean < 1 ? mean : 1.0f;
  args.error[pixel] = error * error;
}

// Window and constants of SSIM (Wang et al. 2004): 11 x 11 Gaussian, sigma 1.5 px, values in [0, 1].
inline constexpr int kSsimRadius = 5;  // px
inline constexpr float kSsimC1 = 0.01f * 0.01f;
inline constexpr float kSsimC2 = 0.03f * 0.03f;

/// Returns the weight of a tap of the separable window at a distance of 0 to 5 px from the centre: exp(-d^2 / 4.5),
/// scaled so that all 11 weights sum to 1. These are literals, because std::exp is not constexpr. A test recomputes
/// them.
B3DGS_HD constexpr float ssim_weight(int distance) {
  return distance == 0   ? 2.660117249e-01f
         : distance == 1 ? 2.130055377e-01f
         : distance == 2 ? 1.093606895e-01f
         : distance == 3 ? 3.600077213e-02f
         : distance == 4 ? 7.598758135e-03f
                         : 1.028380084e-03f;
}

namespace cuda {

/// Returns the size of the workspace for an image in floats. The workspace must be aligned to 8 bytes.
std::int64_t loss_workspace_size(std::int32_t width, std::int32_t height);

/// Writes the loss to `value` (on the device, or in pinned memory) and the gradient. Sums have a fixed order.
/// Asynchronous.
void compute_loss(const LossArgs& args, LossValue* value, cudaStream_t stream);

}  // namespace cuda
}  // namespace b3dgs
