// (d) combined, the paper's fine-grained combined load balancing: dynamic and gaussian-wise together, with tasks of
// four pixels, the paper's fine-grained tile. A patch becomes 32 tasks, so no block works longer than four pixels take.
//   Grid: as many blocks as are resident at once, which take tasks from an atomic counter.
//   Block: a task of 2 x 2 px (the paper does not say which four). It stages the whole list of the patch, batch by
//     batch, so the list is loaded 32 times.
//   Warp: one of the four pixels.

#include "raster/cuda/paper/gaussian_wise.cuh"

namespace b3dgs::cuda {
namespace {

constexpr std::int32_t kRowQuads = kPatchWidth / kQuadSide, kPatchQuads = kPatchThreads / kQuadPixels;
static_assert(kPatchQuads == 32 && kPatchThreads == kQuadPixels * kWarpSize, "a warp per pixel");

/// Blends one task with the whole block.
__device__ __forceinline__ void blend_quad(const BlendForwardArgs& blend, StagedShapes& batch, std::int32_t task) {
  const std::int32_t patch = task / kPatchQuads, quad = task % kPatchQuads;
  const std::int32_t warp = static_cast<std::int32_t>(threadIdx.x) / kWarpSize;
  const std::int32_t x = quad % kRowQuads * kQuadSide + warp % kQuadSide;
  const std::int32_t y = quad / kRowQuads * kQuadSide + warp / kQuadSide;
  const TilePixel at = patch_pixel(blend.grid, patch, y * kPatchWidth + x);
  const std::int64_t first = blend.bins.tile_offsets[patch], end = blend.bins.tile_offsets[patch + 1];
  WarpPixel pixel;
  pixel.is_finished = !at.inside;
  for (std::int64_t start = first;; start += kPatchThreads) {
    const int n = stage_batch(blend, batch, start, end, pixel.is_finished);
    if (n == 0) break;
    blend_batch(blend, batch, n, static_cast<std::int32_t>(start - first), at.center_x(), at.center_y(), pixel);
  }
  const float4 sum = warp_sum(pixel.color_depth);
  if (at.inside && lane_id() == 0) {
    store_pixel(blend, at, {pixel.transmittance, sum.x, sum.y, sum.z, sum.w}, pixel.last);
  }
}

__global__ void __launch_bounds__(kPatchThreads) combined_kernel(const PaperArgs args) {
  __shared__ StagedShapes batch;
  __shared__ std::int32_t task;
  note_start(args);
  while (true) {
    __syncthreads();  // all threads have read the previous task number
    if (threadIdx.x == 0) task = atomicAdd(args.next_task, 1);
    __syncthreads();
    if (task >= kPatchQuads * args.blend.grid.n_tiles()) break;
    blend_quad(args.blend, batch, task);
  }
  note_end(args);
}

}  // namespace

PaperKernel paper_combined() {
  return {combined_kernel, /*takes_tasks=*/true};
}

}  // namespace b3dgs::cuda
