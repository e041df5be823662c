// What the backward blend of a view leaves for the backward projection, kept so that this can follow after other views.
#pragma once

#include <cstdint>

#include "raster/args.h"

namespace b3dgs {

/// Sums of one splat, with all that turns them into the gradient of its Gaussian.
struct alignas(16) SplatRecord {
  SplatGrad sum;
  std::int32_t gaussian;  // < N
  std::uint32_t clamped;  // as in Splat
};
static_assert(sizeof(SplatRecord) == 48, "three 16-byte words");

/// Of one view with N Gaussians and M splats.
struct SplatRecordArrays {
  SplatRecord* records = nullptr;              // [M] out, in any order
  std::int32_t* record_of_gaussian = nullptr;  // [N] out: index in `records`; -1 if the view does not see the Gaussian
  float* means2d = nullptr;                    // [N, 2] out: gradient of the projected centre, 1/px; 0 if not seen
};

}  // namespace b3dgs
