// A patch of the paper's kernels: its pixels, a batch of its list in shared memory, and the timing of a block.
#pragma once

#include "raster/cuda/forward/tile_blend.cuh"
#include "raster/cuda/paper/paper.h"

namespace b3dgs::cuda {

/// Returns pixel `index` of a patch, counted row by row.
__device__ __forceinline__ TilePixel patch_pixel(const TileGrid& grid, std::int32_t patch, std::int32_t index) {
  const std::int32_t x = patch % grid.columns * kPatchWidth + index % kPatchWidth;
  const std::int32_t y = patch / grid.columns * kPatchHeight + index / kPatchWidth;
  return {x, y, index, x < grid.image_width && y < grid.image_height};
}

/// The data that the paper's naive kernel stages in shared memory for a batch of 128 list entries: point list, centres,
/// and conics with opacities. Colours and depths stay in global memory.
struct StagedShapes {
  std::int32_t id[kPatchThreads];
  float2 mean[kPatchThreads];
  float4 conic_opacity[kPatchThreads];

  /// Each thread stages one splat.
  __device__ __forceinline__ void stage(const Splat* splats, std::int32_t splat) {
    const float4 center = load_mean(splats, splat), conic = load_conic(splats, splat);
    id[threadIdx.x] = splat;
    mean[threadIdx.x] = make_float2(center.x, center.y);
    conic_opacity[threadIdx.x] = make_float4(conic.x, conic.y, conic.z, center.z);
  }
  __device__ __forceinline__ SplatShape<float> shape(int j) const {
    const float4 conic = conic_opacity[j];
    return {mean[j].x, mean[j].y, conic.w, conic.x, conic.y, conic.z};
  }
  /// Returns red, green, blue and depth.
  __device__ __forceinline__ float4 color_depth(const Splat* splats, int j) const {
    const float4 color = load_color(splats, id[j]);
    return make_float4(color.x, color.y, color.z, __ldg(&splats[id[j]].depth));
  }
};

/// Stages entries [start, end) of the lists, at most 128. Has one barrier before, so that no thread still reads the
/// previous batch, and one after. Returns the number of entries, or 0 if all pixels of the block are finished or no
/// entry is left.
template <class Batch>
__device__ __forceinline__ int stage_batch(const BlendForwardArgs& blend, Batch& batch, std::int64_t start,
                                           std::int64_t end, bool is_finished) {
  if (__syncthreads_and(is_finished) || start >= end) return 0;
  if (start + threadIdx.x < end) batch.stage(blend.splats, blend.bins.splat_ids[start + threadIdx.x]);
  __syncthreads();
  return static_cast<int>(min(end - start, std::int64_t{kPatchThreads}));
}

/// Must be called by all threads of a block when it begins.
__device__ __forceinline__ void note_start(const PaperArgs& args) {
  if (args.runs == nullptr || threadIdx.x != 0) return;
  BlockRun& run = args.runs[blockIdx.x];
  asm volatile("mov.u32 %0, %%smid;" : "=r"(run.multiprocessor));
  run.start = static_cast<unsigned long long>(clock64());
}

/// Must be called by all threads of a block when it ends. The last warp determines the time.
__device__ __forceinline__ void note_end(const PaperArgs& args) {
  if (args.runs == nullptr || lane_id() != 0) return;
  atomicMax(&args.runs[blockIdx.x].end, static_cast<unsigned long long>(clock64()));
}

}  // namespace b3dgs::cuda
