// Forward blend, naive: the baseline.
//   Threads: each gets an equal, contiguous share of the tiles before it starts; there is no balancing. A thread whose
//     share contains the crowded tiles finishes last.
//   Lanes: pixels of a row. Every row of the tile evaluates every splat of the list (blend_tile_pixelwise()).
//   Splats: read from the array of all splats through the list, not staged.
//   Ends: once per 32 splats, a tile checks whether any of its pixels is unfinished.
//   For the backward pass: final transmittance and position of the last splat, per pixel.

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "raster/cpu/forward/forward_naive.cpp"
#include <hwy/foreach_target.h>
// Everything below is compiled once per instruction set.
#include "raster/cpu/forward/tile_pixels-inl.h"

#include "core/parallel.h"
#include "raster/cpu/forward/forward_table.h"

HWY_BEFORE_NAMESPACE();
namespace b3dgs {
namespace HWY_NAMESPACE {

void run_forward_naive(const BlendForwardArgs& args, std::int64_t begin, std::int64_t end) {
  TilePixels tile;
  for (std::int64_t i = begin; i < end; ++i) blend_tile_pixelwise(args, tile, i);
}

}  // namespace HWY_NAMESPACE
}  // namespace b3dgs
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace b3dgs {
HWY_EXPORT(run_forward_naive);

namespace cpu {

void blend_forward_naive(const BlendForwardArgs& args) {
  parallel_chunks(args.grid.n_tiles(), 1, [&](std::int64_t begin, std::int64_t end) {
    HWY_DYNAMIC_DISPATCH(run_forward_naive)(args, begin, end);
  });
}

}  // namespace cpu
}  // namespace b3dgs
#endif
