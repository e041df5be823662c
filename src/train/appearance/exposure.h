// An affine transform of an image's colours, forward and backward, without torch: what CPU and GPU share.
#pragma once

#include <cstdint>

#include "core/vec.h"
#include "train/optimizer/adam_args.h"

namespace b3dgs {

/// Elements of a transform: [3, 4], colour' = transform (r, g, b, 1).
inline constexpr int kExposureSize = 12;

/// Pixels whose part of the transform's gradient is summed at once. The same on every device, so that the order of
/// sums depends on the image only.
inline constexpr std::int64_t kExposureBlock = 4096;

/// Values of a photograph from here on may be clipped: the scene may have been brighter.
inline constexpr std::uint8_t kClippedValue = 254;

/// All arrays are on one device.
struct ExposureArgs {
  std::int64_t n_pixels = 0;
  const float* transform = nullptr;          // [3, 4]
  const float* rendered = nullptr;           // [H, W, 3]
  const std::uint8_t* photograph = nullptr;  // [H, W, 3], or null: nothing is clipped
  float* corrected = nullptr;                // [H, W, 3] out of the forward pass
  float* grad = nullptr;                     // [H, W, 3] backward pass: dL/d(corrected) in, dL/d(rendered) out
  double* block_sums = nullptr;              // [n_blocks, 12] scratch of the backward pass
  float* transform_grad = nullptr;           // [3, 4] out of the backward pass

  B3DGS_HD std::int64_t n_blocks() const { return (n_pixels + kExposureBlock - 1) / kExposureBlock; }
};

/// Channel i of the transformed colour.
B3DGS_HD float exposed_value(const ExposureArgs& args, std::int64_t pixel, int i) {
  const float *color = args.rendered + 3 * pixel, *a = args.transform;
  return a[4 * i] * color[0] + a[4 * i + 1] * color[1] + a[4 * i + 2] * color[2] + a[4 * i + 3];
}

/// The photograph's value, if it is clipped and `value` is brighter; otherwise `value`.
B3DGS_HD float clipped_value(const ExposureArgs& args, std::int64_t pixel, int i, float value) {
  if (args.photograph == nullptr || args.photograph[3 * pixel + i] < kClippedValue) return value;
  const float most = static_cast<float>(args.photograph[3 * pixel + i]) / 255.0f;
  return value > most ? most : value;
}

/// Writes one pixel of `corrected`.
B3DGS_HD void expose_pixel(const ExposureArgs& args, std::int64_t pixel) {
  for (int i = 0; i < 3; ++i) {
    args.corrected[3 * pixel + i] = clipped_value(args, pixel, i, exposed_value(args, pixel, i));
  }
}

/// Replaces the pixel's gradient, and adds its part of dL/d(transform) to `sums`.
template <class Sum>
B3DGS_HD void expose_pixel_backward(const ExposureArgs& args, std::int64_t pixel, Sum (&sums)[kExposureSize]) {
  const float *color = args.rendered + 3 * pixel, *a = args.transform;
  float* grad = args.grad + 3 * pixel;
  float g[3] = {grad[0], grad[1], grad[2]};
  for (int i = 0; i < 3; ++i) {
    const float value = exposed_value(args, pixel, i);
    if (clipped_value(args, pixel, i, value) < value) g[i] = 0;
    for (int j = 0; j < 3; ++j) sums[4 * i + j] += static_cast<Sum>(g[i]) * static_cast<Sum>(color[j]);
    sums[4 * i + 3] += static_cast<Sum>(g[i]);
  }
  for (int j = 0; j < 3; ++j) grad[j] = a[j] * g[0] + a[4 + j] * g[1] + a[8 + j] * g[2];
}

/// One Adam step for the transforms of all photographs. Only one has a gradient; the others move by their moments, as
/// with torch.optim.Adam. Then all are shifted so that their mean is the identity: brighter transforms with a darker
/// model would fit the photographs as well, and the first steps, when renders are still dark, would lead there.
struct ExposureStepArgs {
  AdamArgs adam{};                        // all transforms; `grad` is not used
  std::int64_t first = 0;                 // element of the transform that has a gradient
  const float* transform_grad = nullptr;  // [3, 4] on the device of the transforms
};

/// What is to be subtracted from element `k` of all transforms, from the sum of these elements.
B3DGS_HD float mean_excess(const ExposureStepArgs& args, int k, double sum) {
  const double identity = k % 5 == 0 ? 1 : 0;  // elements 0, 5 and 10
  const std::int64_t n_transforms = args.adam.n / kExposureSize;
  return static_cast<float>(sum / static_cast<double>(n_transforms) - identity);
}

namespace cuda {

// Everything is asynchronous.

/// Sums have a fixed order.
void exposure_backward(const ExposureArgs& args, cudaStream_t stream);

void exposure_step(const ExposureStepArgs& args, cudaStream_t stream);

}  // namespace cuda
}  // namespace b3dgs
