// What the forward blend looks at for one pixel, counted: the blend's own arithmetic with nothing to show.
#pragma once

#include <cstdint>

#include "raster/args.h"
#include "raster/math/blend.h"

namespace b3dgs {

/// A pixel while the entries of its tile's list are counted, front to back.
struct PixelLoad {
  PixelState<float> pixel{1, 0, 0, 0, 0};
  std::int32_t processed = 0;     // entries looked at, with the one that finishes the pixel
  std::int32_t contributing = 0;  // entries blended
};

/// Counts one entry at a pixel centre (px). False: the pixel is finished, and no later entry is looked at.
B3DGS_HD bool count_entry(PixelLoad& load, const SplatShape<float>& shape, float center_x, float center_y) {
  ++load.processed;
  const Reach<float> reach = evaluate_reach(shape, center_x, center_y);
  if (!reach.contributes) return true;
  if (!blend_over(load.pixel, true, evaluate_alpha(reach.power).alpha, 0.0f, 0.0f, 0.0f, 0.0f)) return false;
  ++load.contributing;
  return true;
}

}  // namespace b3dgs
