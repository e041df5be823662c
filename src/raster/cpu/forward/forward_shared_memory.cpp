// Forward blend, shared-memory. On a CPU, the first-level cache takes the part of shared memory.
//   Threads: take tiles from an atomic counter.
//   Lanes: pixels of a row.
//   Splats: staged in batches of 32, each with the rows of the tile that it reaches; other rows skip it
//     (staged_splats-inl.h).
//   Ends: once per batch, rows whose pixels are all finished are dropped at the top and bottom of the tile.

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "raster/cpu/forward/forward_shared_memory.cpp"
#include <hwy/foreach_target.h>
// Everything below is compiled once per instruction set.
#include "raster/cpu/forward/staged_splats-inl.h"

#include "core/parallel.h"
#include "raster/cpu/forward/forward_table.h"

HWY_BEFORE_NAMESPACE();
namespace b3dgs {
namespace HWY_NAMESPACE {

void run_forward_shared_memory(const BlendForwardArgs& args, std::int64_t index) {
  TilePixels tile;
  tile.begin(args.grid, static_cast<std::int32_t>(index));
  blend_staged(args, index, tile);
  tile.finish(args);
}

}  // namespace HWY_NAMESPACE
}  // namespace b3dgs
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace b3dgs {
HWY_EXPORT(run_forward_shared_memory);

namespace cpu {

void blend_forward_shared_memory(const BlendForwardArgs& args) {
  parallel_pool(args.grid.n_tiles(), [&](std::int64_t tile, int) {
    HWY_DYNAMIC_DISPATCH(run_forward_shared_memory)(args, tile);
  });
}

}  // namespace cpu
}  // namespace b3dgs
#endif
