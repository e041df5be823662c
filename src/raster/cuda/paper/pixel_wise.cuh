// The body of naive, dynamic and shared-memory: a thread blends one pixel of a patch (Algorithm 2 of the paper).
#pragma once

#include "raster/cuda/paper/patch.cuh"

namespace b3dgs::cuda {

/// Blends a patch with the whole block. `Batch` determines the staged data: StagedShapes or StagedColors.
///   Stage: each thread loads one splat of the batch to shared memory.
///   Blend: each thread evaluates the batch's splats in order. It stops early at the splat that would bring the
///     transmittance of its pixel below 1e-4. The block stops when all its pixels have stopped.
///   Barriers: two per batch, which all threads reach, whether or not their pixel is finished.
template <class Batch>
__device__ __forceinline__ void blend_patch(const BlendForwardArgs& blend, Batch& batch, std::int32_t patch) {
  const TilePixel at = patch_pixel(blend.grid, patch, static_cast<std::int32_t>(threadIdx.x));
  const float center_x = at.center_x(), center_y = at.center_y();
  const std::int64_t first = blend.bins.tile_offsets[patch], end = blend.bins.tile_offsets[patch + 1];
  PixelState<float> pixel{1, 0, 0, 0, 0};
  std::int32_t last_blended = -1;
  bool is_finished = !at.inside;
  for (std::int64_t start = first;; start += kPatchThreads) {
    const int n = stage_batch(blend, batch, start, end, is_finished);
    if (n == 0) break;
    for (int j = 0; j < n && !is_finished; ++j) {
      const Footprint<float> footprint = evaluate_footprint(batch.shape(j), center_x, center_y);
      if (!footprint.contributes) continue;
      const float alpha = evaluate_alpha(footprint.power).alpha;
      const float4 color = batch.color_depth(blend.splats, j);
      is_finished = !blend_over(pixel, true, alpha, color.x, color.y, color.z, color.w);
      if (!is_finished) last_blended = static_cast<std::int32_t>(start - first) + j;
    }
  }
  if (at.inside) store_pixel(blend, at, pixel, last_blended);
}

}  // namespace b3dgs::cuda
