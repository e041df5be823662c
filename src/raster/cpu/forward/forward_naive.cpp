// Forward blend, naive: lanes over pixels, tiles divided over the threads beforehand, splats read where they lie. The
// baseline of the comparison: a thread whose share holds the crowded tiles works on while the others are done.

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "raster/cpu/forward/forward_naive.cpp"
#include <hwy/foreach_target.h>
// Once per target from here.
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
