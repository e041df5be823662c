// Reduces a photograph to 1 / scale of its size by averaging scale x scale pixels (an area filter). CPU and GPU use the
// same integer arithmetic, so they give the same bytes. Focal lengths and principal point are divided by the scale
// (reduced_camera()).
#pragma once

#include <cstdint>

#include "core/vec.h"

namespace b3dgs {

/// Arguments of reduce_pixel(). All arrays are on one device and contiguous. A reduced row has width / scale pixels and
/// a reduced column height / scale, both rounded down. Remaining pixels at the right and the bottom are not used.
struct ReduceImageArgs {
  std::int32_t width = 0, height = 0;     // size of the full image, px
  std::int32_t scale = 1;                 // at most 255
  const std::uint8_t* rgb = nullptr;      // [H, W, 3]; null: only the mask is reduced
  const std::uint8_t* valid = nullptr;    // [H, W] 0 = pixel is ignored; null = all count
  std::uint8_t* reduced = nullptr;        // [H / scale, W / scale, 3] out
  std::uint8_t* reduced_valid = nullptr;  // [H / scale, W / scale] out, 0 or 1; null if `valid` is null

  B3DGS_HD std::int32_t reduced_width() const { return width / scale; }
  B3DGS_HD std::int32_t reduced_height() const { return height / scale; }
  B3DGS_HD std::int64_t n_reduced() const { return std::int64_t{reduced_width()} * reduced_height(); }
};

/// Writes reduced pixel `out`, the mean of the valid pixels that it covers, rounded to the nearest integer with halves
/// up, or 0 if none is valid. It counts as valid if at least half of these pixels are.
B3DGS_HD void reduce_pixel(const ReduceImageArgs& args, std::int64_t out) {
  const std::int64_t x = out % args.reduced_width(), y = out / args.reduced_width();
  std::int32_t sum[3] = {0, 0, 0}, n = 0;
  for (std::int32_t dy = 0; dy < args.scale; ++dy) {
    const std::int64_t first = (y * args.scale + dy) * args.width + x * args.scale;
    for (std::int64_t p = first; p < first + args.scale; ++p) {
      if (args.valid != nullptr && args.valid[p] == 0) continue;
      for (int c = 0; args.rgb != nullptr && c < 3; ++c) sum[c] += args.rgb[3 * p + c];
      ++n;
    }
  }
  for (int c = 0; args.rgb != nullptr && c < 3; ++c) {
    args.reduced[3 * out + c] = static_cast<std::uint8_t>(n == 0 ? 0 : (sum[c] + n / 2) / n);
  }
  if (args.reduced_valid != nullptr) args.reduced_valid[out] = 2 * n >= args.scale * args.scale ? 1 : 0;
}

}  // namespace b3dgs
