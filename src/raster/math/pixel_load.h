// Counts the list entries that the forward blend evaluates and blends for one pixel, with the blend's own arithmetic.
#pragma once

#include <cstdint>

#include "raster/args.h"
#include "raster/math/blend.h"

namespace b3dgs {

/// Counters of one pixel while its tile's list is read front to back.
struct PixelLoad {
  PixelState<float> pixel{1, 0, 0, 0, 0};
  std::int32_t processed = 0;     // entries evaluated, including the one that finishes the pixel
  std::int32_t contributing = 0;  // entries blended
};

/// Counts one entry at a pixel centre (px). Returns false once the pixel is finished.
B3DGS_HD bool count_entry(PixelLoad& load, const SplatShape<float>& shape, float center_x, float center_y) {
  ++load.processed;
  const Footprint<float> footprint = evaluate_footprint(shape, center_x, center_y);
  if (!footprint.contributes) return true;
  if (!blend_over(load.pixel, true, evaluate_alpha(footprint.power).alpha, 0.0f, 0.0f, 0.0f, 0.0f)) return false;
  ++load.contributing;
  return true;
}

}  // namespace b3dgs
