// Sums over the pairs of a splat.
#pragma once

#include "raster/args.h"

namespace b3dgs::cpu {

/// In the order of the slots, [first, last).
inline SplatGrad sum_slots(const SplatGrad* first, const SplatGrad* last) {
  SplatGrad sum{};
  for (const SplatGrad* part = first; part != last; ++part) {
    sum.log_alpha += part->log_alpha;
    sum.mean_x += part->mean_x;
    sum.mean_y += part->mean_y;
    sum.cov_xx += part->cov_xx;
    sum.cov_xy += part->cov_xy;
    sum.cov_yy += part->cov_yy;
    sum.red += part->red;
    sum.green += part->green;
    sum.blue += part->blue;
    sum.depth += part->depth;
  }
  return sum;
}
inline Vec2f sum_slots(const Vec2f* first, const Vec2f* last) {
  Vec2f sum{0, 0};
  for (const Vec2f* part = first; part != last; ++part) {
    sum.x += part->x;
    sum.y += part->y;
  }
  return sum;
}

}  // namespace b3dgs::cpu
