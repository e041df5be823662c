// (c) gaussian-wise, the paper's Gaussian-wise parallel rendering (Algorithms 4 to 6): a block per patch, as in naive.
// Each warp has 32 of the patch's pixels. For every batch in shared memory, it blends its unfinished pixels one after
// the other, with all lanes on one pixel. No lane waits for another pixel, but the block of the most crowded patch
// still runs longest.
//
// Between batches, lane p keeps pixel p of the warp, so that stores are coalesced.

#include "raster/cuda/paper/gaussian_wise.cuh"

namespace b3dgs::cuda {
namespace {

__global__ void __launch_bounds__(kPatchThreads) gaussian_wise_kernel(const PaperArgs args) {
  __shared__ StagedShapes batch;
  note_start(args);
  const BlendForwardArgs& blend = args.blend;
  const auto patch = static_cast<std::int32_t>(blockIdx.x), thread = static_cast<std::int32_t>(threadIdx.x);
  const TilePixel at = patch_pixel(blend.grid, patch, thread);
  const float own_x = at.center_x(), own_y = at.center_y();
  const std::int64_t first = blend.bins.tile_offsets[patch], end = blend.bins.tile_offsets[patch + 1];
  PixelState<float> own{1, 0, 0, 0, 0};
  std::int32_t own_last = -1;
  bool is_finished = !at.inside;
  for (std::int64_t start = first;; start += kPatchThreads) {
    const int n = stage_batch(blend, batch, start, end, is_finished);
    if (n == 0) break;
    for (unsigned open = __ballot_sync(kFullWarp, !is_finished); open != 0; open &= open - 1) {
      const int p = __ffs(static_cast<int>(open)) - 1;
      WarpPixel pixel;
      pixel.transmittance = __shfl_sync(kFullWarp, own.transmittance, p);
      const float center_x = __shfl_sync(kFullWarp, own_x, p), center_y = __shfl_sync(kFullWarp, own_y, p);
      blend_batch(blend, batch, n, static_cast<std::int32_t>(start - first), center_x, center_y, pixel);
      if (pixel.last < 0 && !pixel.is_finished) continue;
      const float4 sum = warp_sum(pixel.color_depth);
      if (lane_id() == p) {
        own = {pixel.transmittance, own.red + sum.x, own.green + sum.y, own.blue + sum.z, own.depth + sum.w};
        if (pixel.last >= 0) own_last = pixel.last;
        is_finished = pixel.is_finished;
      }
    }
  }
  if (at.inside) store_pixel(blend, at, own, own_last);
  note_end(args);
}

}  // namespace

PaperKernel paper_gaussian_wise() {
  return {gaussian_wise_kernel, /*takes_tasks=*/false};
}

}  // namespace b3dgs::cuda
