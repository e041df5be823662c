// Forward blend, a thread per pixel.
//   naive: the paper's baseline, and the reference if kernels disagree. A block per tile: it runs as
//     long as its slowest pixel, and the most crowded tile determines the time of the launch.
//   dynamic: the paper's inter-block dynamic workload distribution. As many blocks as are resident at once take tiles
//     from an atomic counter until none is left. The hardware's block scheduler does nearly the same for naive, so the
//     gain is small: a single tile that costs more than a block's fair share still determines the time.
//   shared-memory: tiles assigned statically, the longest list first, so that none is left when the others are done;
//     splats staged completely and culled by sub-tile (staged_blend.cuh).
//
// naive and dynamic, as in the paper:
//   Stage: each thread loads one splat of the batch to shared memory: its id, mean, opacity and conic.
//   Blend: each thread (row by row; a warp has two rows of 16) evaluates the batch's splats in order, and reads colour
//     and depth from global memory only where the splat contributes.
//   Barriers: two per batch; dynamic has two more per tile, to hand out the task. A block stops once all of its pixels
//     are finished.
//
// Saved for the backward pass: final transmittance, last splat, and bucket parts (BucketParts).

#include "raster/cuda/blend_kernels.h"
#include "raster/cuda/forward/staged_blend.cuh"
#include "raster/cuda/launch.cuh"

namespace b3dgs::cuda {
namespace {

constexpr int kThreads = kCudaTilePixels;  // of naive and dynamic

/// A batch of splats in shared memory, one per thread of the block.
struct StagedBatch {
  float4 mean[kThreads];
  float4 conic[kThreads];
  std::int32_t id[kThreads];
};

/// Blends a tile with the whole block. All threads reach both barriers of a batch, whether or not their pixel is
/// finished.
__device__ __forceinline__ void blend_tile_pixelwise(const BlendForwardCudaArgs& args, StagedBatch& batch,
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
      batch.mean[threadIdx.x] = load_mean(blend.splats, id);
      batch.conic[threadIdx.x] = load_conic(blend.splats, id);
    }
    __syncthreads();  // the batch is complete

    const int n = static_cast<int>(last - start < kThreads ? last - start : kThreads);
    // Bucket by bucket, since the backward pass needs what each bucket adds to the pixel.
    for (int bucket = 0; bucket < n && !done; bucket += kBucketEntries) {
      const int bucket_end = bucket + kBucketEntries < n ? bucket + kBucketEntries : n;
      PixelState<float> part{pixel.transmittance, 0, 0, 0, 0};
      for (int j = bucket; j < bucket_end; ++j) {
        const SplatShape<float> shape = make_splat_shape(batch.mean[j], batch.conic[j]);
        const Footprint<float> footprint = evaluate_footprint(shape, center_x, center_y);
        if (!footprint.contributes) continue;
        const float alpha = evaluate_alpha(footprint.power).alpha;
        const float4 color = load_color(blend.splats, batch.id[j]);
        const float depth = __ldg(&blend.splats[batch.id[j]].depth);
        done = !blend_over(part, true, alpha, color.x, color.y, color.z, depth);
        if (done) break;
        last_blended = static_cast<std::int32_t>(start - first) + j;
      }
      pixel = sum_of(pixel, part);
      if (args.parts.color != nullptr) store_bucket_part(args, tile, start - first + bucket, at.index, part);
    }
  }
  if (at.inside) store_pixel(blend, at, pixel, last_blended);
}

__global__ void __launch_bounds__(kThreads) forward_naive_kernel(const BlendForwardCudaArgs args) {
  __shared__ StagedBatch batch;
  blend_tile_pixelwise(args, batch, static_cast<std::int32_t>(blockIdx.x));
}

__global__ void __launch_bounds__(kThreads) forward_dynamic_kernel(const BlendForwardCudaArgs args) {
  __shared__ StagedBatch batch;
  __shared__ std::int32_t tile;
  while (true) {
    __syncthreads();  // all threads have finished with the previous tile
    if (threadIdx.x == 0) tile = atomicAdd(args.next_task, 1);
    __syncthreads();  // the next one is known
    if (tile >= args.blend.grid.n_tiles()) return;
    blend_tile_pixelwise(args, batch, tile);
  }
}

__global__ void __launch_bounds__(kStagedThreads) forward_shared_memory_kernel(const BlendForwardCudaArgs args) {
  __shared__ StagedSplats staged;
  const BlendForwardArgs& blend = args.blend;
  const std::int32_t tile = args.tiles_by_length[blockIdx.x / kStagedBlocks];
  const TilePixel at = staged_pixel(blend.grid, tile, static_cast<int>(blockIdx.x) % kStagedBlocks);
  PixelState<float> pixel{at.inside ? 1.0f : kClosedPixel, 0, 0, 0, 0};
  const std::int32_t last = blend_staged(args, staged, tile, {0, list_length(blend.bins, tile)}, at, pixel);
  if (at.inside) store_pixel(blend, at, pixel, last);
}

}  // namespace

void launch_forward_naive(const BlendForwardCudaArgs& args, const LaunchContext& context) {
  launch_blocks(forward_naive_kernel, args.blend.grid.n_tiles(), kThreads, context, args);
}

void launch_forward_dynamic(const BlendForwardCudaArgs& args, const LaunchContext& context) {
  reset_tasks(args.next_task, context);
  const int blocks = resident_blocks(forward_dynamic_kernel, kThreads, context);
  launch_blocks(forward_dynamic_kernel, blocks, kThreads, context, args);
}

void launch_forward_shared_memory(const BlendForwardCudaArgs& args, const LaunchContext& context) {
  const int blocks = args.blend.grid.n_tiles() * kStagedBlocks;
  launch_blocks(forward_shared_memory_kernel, blocks, kStagedThreads, context, args);
}

}  // namespace b3dgs::cuda
