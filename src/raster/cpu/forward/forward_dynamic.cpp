// Forward blend, dynamic: naive with inter-block balancing (the paper's inter-block dynamic workload distribution).
//   Threads: take the next tile from an atomic counter until none is left. This balances tiles of different cost, but a
//     single tile that costs more than a thread's fair share still determines the time.
//   Lanes, splats, end and outputs: as naive (blend_tile_pixelwise()).

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "raster/cpu/forward/forward_dynamic.cpp"
#include <hwy/foreach_target.h>
// Everything below is compiled once per instruction set.
#include "raster/cpu/forward/tile_pixels-inl.h"

#include "core/parallel.h"
#include "raster/cpu/forward/forward_table.h"

HWY_BEFORE_NAMESPACE();
namespace b3dgs {
namespace HWY_NAMESPACE {

void run_forward_dynamic(const BlendForwardArgs& args, std::int64_t task) {
  TilePixels tile;
  blend_tile_pixelwise(args, tile, task);
}

}  // namespace HWY_NAMESPACE
}  // namespace b3dgs
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace b3dgs {
HWY_EXPORT(run_forward_dynamic);

namespace cpu {

void blend_forward_dynamic(const BlendForwardArgs& args) {
  parallel_pool(args.grid.n_tiles(), [&](std::int64_t tile, int) {
    HWY_DYNAMIC_DISPATCH(run_forward_dynamic)(args, tile);
  });
}

}  // namespace cpu
}  // namespace b3dgs
#endif
