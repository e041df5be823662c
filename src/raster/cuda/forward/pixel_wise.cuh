// Pixel-wise blending as in the paper's baseline; used by naive and dynamic.
//
//   Block: a tile. Thread: one pixel (row by row; a warp has two rows of 16).
//   Stage: each thread loads one splat of the batch to shared memory: list entry, centre, opacity and conic.
//   Blend: each thread evaluates the batch's splats in order, and reads colour and depth from global memory only where
//     the splat contributes.
//   Barriers: two per batch. A block stops once all of its pixels are finished.
//   Saved for the backward pass: final transmittance, last splat, and bucket parts (BucketParts).
#pragma once

#include "raster/cuda/forward/tile_blend.cuh"

namespace b3dgs::cuda {

/// A batch of splats in shared memory, one per thread of the block.
template <int kThreads>
struct StagedBatch {
  float4 mean[kThreads];
  float4 conic[kThreads];
  std::int32_t id[kThreads];
};

/// Blends a tile with the whole block. All threads reach both barriers of a batch, whether or not their pixel is
/// finished.
template <int kThreads>
__device__ __forceinline__ void blend_tile_pixelwise(const BlendForwardCudaArgs& args, StagedBatch<kThreads>& batch,
                                                     std::int32_t tile) {
  const BlendForwardArgs& blend = args.blend;
  const TilePixel at = tile_pixel(blend.grid, tile, static_cast<std::int32_t>(threadIdx.x));
  const float center_x = at.center_x(), center_y = at.center_y();
  const std::int64_t first = blend.bins.tile_offsets[tile], last = blend.bins.tile_offsets[tile + 1];

  PixelState<float> pixel{1, 0, 0, 0, 0};
  std::int32_t last_blended = -1;
  bool done = !at.inside;
  for (std::int64_t start = first; start < last; start += kThreads) {
    if (__syncthreads_count(done) == kThreads) break;  // also: all threads have finished with the previous batch
    if (start + threadIdx.x < last) {
      const std::int32_t id = blend.bins.splat_ids[start + threadIdx.x];
      batch.id[threadIdx.x] = id;
      batch.mean[threadIdx.x] = load_mean(blend.splats, id).v;
      batch.conic[threadIdx.x] = load_conic(blend.splats, id).v;
    }
    __syncthreads();  // the batch is complete

    const int n = static_cast<int>(last - start < kThreads ? last - start : kThreads);
    // Bucket by bucket, since the backward pass needs what each bucket of 32 adds to the pixel.
    for (int bucket = 0; bucket < n && !done; bucket += kWarpSize) {
      const int bucket_end = bucket + kWarpSize < n ? bucket + kWarpSize : n;
      PixelState<float> part{pixel.transmittance, 0, 0, 0, 0};
      for (int j = bucket; j < bucket_end; ++j) {
        const SplatShape<float> shape = make_splat_shape({batch.mean[j]}, {batch.conic[j]});
        const Footprint<float> footprint = evaluate_footprint(shape, center_x, center_y);
        if (!footprint.contributes) continue;
        const float alpha = evaluate_alpha(footprint.power).alpha;
        const float4 color = load_color(blend.splats, batch.id[j]).v;
        const float depth = __ldg(&blend.splats[batch.id[j]].depth);
        done = !blend_over(part, true, alpha, color.x, color.y, color.z, depth);
        if (done) break;
        last_blended = static_cast<std::int32_t>(start - first) + j;
      }
      pixel = {part.transmittance, pixel.red + part.red, pixel.green + part.green, pixel.blue + part.blue,
               pixel.depth + part.depth};
      if (args.parts.color != nullptr) {
        store_bucket_part(args, tile, start - first + bucket, at.index, part);
      }
    }
  }
  if (at.inside) store_pixel(blend, at, pixel, last_blended);
}

}  // namespace b3dgs::cuda
