// The gradient of the depth loss, without torch, with the same arithmetic on CPU and GPU:
//   loss = weight * mean over valid pixels of |rendered - (scale * map + offset)|
// `rendered` has RenderSettings::inverse_depth. The map has the size of the full view. A pixel of a view reduced to 1 /
// reduction of its size is compared with the mean of the pixels that it covers.
#pragma once

#include <cstdint>

#include "core/vec.h"

namespace b3dgs {

/// Arguments of depth_loss_grad_at(). All arrays are on one device and contiguous.
struct DepthLossArgs {
  std::int32_t width = 0, height = 0;   // size of the render, px
  const float* rendered = nullptr;      // [H, W] 1 / world units
  const std::uint8_t* valid = nullptr;  // [H, W] 0 = pixel is ignored; null = all count
  std::int32_t map_width = 0;           // px
  std::int32_t reduction = 1;  // pixel (x, y) covers reduction^2 pixels of the map, from (reduction x, reduction y)
  const std::uint16_t* map = nullptr;       // [map height, map width]
  const std::uint8_t* map_valid = nullptr;  // same shape, 0 = no value; null = all have one
  float scale = 0, offset = 0;              // 1 / world units per unit of the map; 1 / world units
  float gradient = 0;                       // weight / number of valid pixels
  float* grad = nullptr;                    // [H, W] out: dL/d(rendered)
};

/// Returns the mean of the map's values that a pixel covers, or a negative number if it covers none.
B3DGS_HD float map_value_at(const DepthLossArgs& args, std::int32_t x, std::int32_t y) {
  std::uint32_t sum = 0, count = 0;  // at most 8 x 8 values of 16 bits
  for (std::int32_t row = y * args.reduction; row < (y + 1) * args.reduction; ++row) {
    for (std::int32_t column = x * args.reduction; column < (x + 1) * args.reduction; ++column) {
      const std::int64_t at = std::int64_t{row} * args.map_width + column;
      if (args.map_valid != nullptr && args.map_valid[at] == 0) continue;
      sum += args.map[at];
      ++count;
    }
  }
  return count > 0 ? static_cast<float>(sum) / static_cast<float>(count) : -1.0f;
}

/// Writes the gradient of one pixel.
B3DGS_HD void depth_loss_grad_at(const DepthLossArgs& args, std::int64_t pixel) {
  args.grad[pixel] = 0;
  if (args.valid != nullptr && args.valid[pixel] == 0) return;
  const float value =
      map_value_at(args, static_cast<std::int32_t>(pixel % args.width), static_cast<std::int32_t>(pixel / args.width));
  if (value < 0) return;
  const float difference = args.rendered[pixel] - (args.scale * value + args.offset);
  args.grad[pixel] = difference > 0 ? args.gradient : difference < 0 ? -args.gradient : 0.0f;
}

}  // namespace b3dgs
