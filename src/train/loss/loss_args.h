// What goes into and comes out of the loss, without torch.
#pragma once

#include <cstdint>

namespace b3dgs {

/// All arrays lie on one device and are contiguous.
struct LossArgs {
  std::int32_t width = 0, height = 0;   // px
  const float* rendered = nullptr;      // [H, W, 3]
  const std::uint8_t* truth = nullptr;  // [H, W, 3]
  const std::uint8_t* valid = nullptr;  // [H, W] 0 where a pixel does not count; null: all count
  std::int64_t n_valid = 0;             // pixels that count
  double lambda_dssim = 0;              // in [0, 1]
  float* grad = nullptr;                // [H, W, 3] out, by `rendered`; null: the value alone
  float* workspace = nullptr;           // loss_workspace_size() floats
};

struct LossValue {
  double loss = 0;
  double l1 = 0;
  double ssim = 0;
};

}  // namespace b3dgs
