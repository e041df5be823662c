// Sums over the pairs of a splat.
#pragma once

#include "raster/args.h"

namespace b3dgs::cpu {

/// In the order of the slots, [first, last).
inline SplatGrad sum_slots(const SplatGrad* first, const SplatGrad* last) {
  SplatGrad sum{};
  for (const SplatGrad* part = first; part != last; ++part) {
    sum.q += part->q;
    sum.q_x += part->q_x;
    sum.q_y += part->q_y;
    sum.q_xx += part->q_xx;
    sum.q_xy += part->q_xy;
    sum.q_yy += part->q_yy;
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
