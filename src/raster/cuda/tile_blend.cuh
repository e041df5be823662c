// What the forward schedules share on the device: splats in registers and shared memory, pixels to the image, states
// for the backward pass.
#pragma once

#include "raster/blend.h"
#include "raster/cuda/passes.h"
#include "raster/cuda/warp.cuh"
#include "raster/tiling.h"

namespace b3dgs::cuda {

/// The three 16-byte words of a Splat.
struct SplatPlace {  // mean_x, mean_y, log2_opacity, depth
  float4 v;
};
struct SplatConic {  // conic_xx, conic_xy, conic_yy, gaussian
  float4 v;
};
struct SplatColor {  // red, green, blue, clamped
  float4 v;
};

__device__ __forceinline__ SplatPlace load_place(const Splat* splats, std::int32_t id) {
  return {__ldg(reinterpret_cast<const float4*>(splats + id))};
}
__device__ __forceinline__ SplatConic load_conic(const Splat* splats, std::int32_t id) {
  return {__ldg(reinterpret_cast<const float4*>(splats + id) + 1)};
}
__device__ __forceinline__ SplatColor load_color(const Splat* splats, std::int32_t id) {
  return {__ldg(reinterpret_cast<const float4*>(splats + id) + 2)};
}
__device__ __forceinline__ SplatShape<float> make_splat_shape(const SplatPlace& place, const SplatConic& conic) {
  return {place.v.x, place.v.y, place.v.z, conic.v.x, conic.v.y, conic.v.z};
}

/// A pixel of the image and of its tile.
struct TilePixel {
  std::int32_t x, y;   // in the image, px
  std::int32_t index;  // in the tile, row by row
  bool inside;         // of the image
  __device__ float center_x() const { return static_cast<float>(x) + 0.5f; }
  __device__ float center_y() const { return static_cast<float>(y) + 0.5f; }
};

__device__ __forceinline__ TilePixel tile_pixel(const TileGrid& grid, std::int32_t tile, std::int32_t index) {
  const std::int32_t x = tile % grid.columns * grid.tile.width + index % grid.tile.width;
  const std::int32_t y = tile / grid.columns * grid.tile.height + index / grid.tile.width;
  return {x, y, index, x < grid.image_width && y < grid.image_height};
}

__device__ __forceinline__ void store_pixel(const BlendForwardArgs& args, const TilePixel& at,
                                            const PixelState<float>& pixel, std::int32_t last) {
  const std::int64_t p = static_cast<std::int64_t>(at.y) * args.grid.image_width + at.x;
  const float t = magnitude(pixel.transmittance);
  args.out.color[3 * p] = pixel.red + t * args.background.x;
  args.out.color[3 * p + 1] = pixel.green + t * args.background.y;
  args.out.color[3 * p + 2] = pixel.blue + t * args.background.z;
  args.out.depth[p] = pixel.depth;
  args.out.alpha[p] = 1 - t;
  args.transmittance[p] = t;
  args.last_ids[p] = last;
}

/// Keeps a pixel's state before the bucket that holds list entry `position`.
__device__ __forceinline__ void store_state(const BucketStates& buckets, const TileGrid& grid, std::int32_t tile,
                                            std::int64_t position, std::int32_t pixel_index,
                                            const PixelState<float>& pixel) {
  const std::int64_t bucket = buckets.offsets[tile] + position / kWarpSize;
  const std::int64_t at = bucket * (grid.tile.width * grid.tile.height) + pixel_index;
  buckets.light[at] = make_float4(pixel.transmittance, pixel.red, pixel.green, pixel.blue);
  buckets.depth[at] = pixel.depth;
}

/// A batch of splats in shared memory, one for each thread of the block.
template <int kThreads, bool kWithFeatures>
struct StagedBatch {
  float4 place[kThreads];
  float4 conic[kThreads];
  float4 color[kWithFeatures ? kThreads : 1];
  std::int32_t id[kWithFeatures ? 1 : kThreads];
};

/// Blends a tile with one thread per pixel. Splats are staged in shared memory batch by batch: with their colours and
/// depths if kWithFeatures, else those are read from global memory where a splat contributes.
///
/// Barriers: each batch begins with one that counts finished pixels, which also tells that everyone has read the last
/// batch; the second says that the new one is complete. All threads reach both, finished or not.
template <int kThreads, bool kWithFeatures>
__device__ __forceinline__ void blend_tile_pixelwise(const BlendForwardCudaArgs& args,
                                                     StagedBatch<kThreads, kWithFeatures>& batch, std::int32_t tile,
                                                     std::int32_t pixel_index) {
  const BlendForwardArgs& blend = args.blend;
  const TilePixel at = tile_pixel(blend.grid, tile, pixel_index);
  const float center_x = at.center_x(), center_y = at.center_y();
  const std::int64_t first = blend.bins.tile_offsets[tile], last = blend.bins.tile_offsets[tile + 1];
  const bool keep_states = args.buckets.offsets != nullptr;

  PixelState<float> pixel{1, 0, 0, 0, 0};
  std::int32_t last_blended = -1;
  bool done = !at.inside;
  for (std::int64_t start = first; start < last; start += kThreads) {
    if (__syncthreads_count(done) == kThreads) break;
    const std::int64_t entry = start + threadIdx.x;
    if (entry < last) {
      const std::int32_t id = blend.bins.splat_ids[entry];
      batch.place[threadIdx.x] = load_place(blend.splats, id).v;
      batch.conic[threadIdx.x] = load_conic(blend.splats, id).v;
      if constexpr (kWithFeatures) {
        batch.color[threadIdx.x] = load_color(blend.splats, id).v;
      } else {
        batch.id[threadIdx.x] = id;
      }
    }
    __syncthreads();

    const int n = static_cast<int>(last - start < kThreads ? last - start : kThreads);
    for (int group = 0; group < n && !done; group += kWarpSize) {
      if (keep_states) store_state(args.buckets, blend.grid, tile, start - first + group, at.index, pixel);
      const int group_end = group + kWarpSize < n ? group + kWarpSize : n;
      for (int j = group; j < group_end; ++j) {
        const SplatShape<float> shape = make_splat_shape({batch.place[j]}, {batch.conic[j]});
        const Reach<float> reach = evaluate_reach(shape, center_x, center_y);
        if (!reach.contributes) continue;
        const Alpha<float> alpha = evaluate_alpha(reach.power);
        float4 color;
        float depth;
        if constexpr (kWithFeatures) {
          color = batch.color[j];
          depth = batch.place[j].w;
        } else {
          color = load_color(blend.splats, batch.id[j]).v;
          depth = __ldg(&blend.splats[batch.id[j]].depth);
        }
        if (!blend_over(pixel, true, alpha.alpha, color.x, color.y, color.z, depth)) {
          done = true;
          break;
        }
        last_blended = static_cast<std::int32_t>(start - first) + j;
      }
    }
  }
  if (at.inside) store_pixel(blend, at, pixel, last_blended);
}

/// One pixel blended by a whole warp, a lane for each of 32 list entries. Colour and depth stay spread over the lanes
/// until the end. Needs no shared memory and no barrier.
__device__ __forceinline__ void blend_pixel_gaussian_wise(const BlendForwardCudaArgs& args, std::int32_t tile,
                                                          const TilePixel& at) {
  const BlendForwardArgs& blend = args.blend;
  const float center_x = at.center_x(), center_y = at.center_y();
  const std::int64_t first = blend.bins.tile_offsets[tile];
  const auto n = static_cast<std::int32_t>(blend.bins.tile_offsets[tile + 1] - first);
  const bool keep_states = args.buckets.offsets != nullptr;
  const int lane = lane_id();

  float transmittance = 1;  // the same in all lanes
  PixelState<float> part{1, 0, 0, 0, 0};
  std::int32_t last_blended = -1;
  // Every lane runs every round: the bound is a whole number of groups, entries beyond the list do not contribute.
  for (std::int32_t group = 0; group < n; group += kWarpSize) {
    const std::int32_t entry = group + lane;
    const std::int32_t id = blend.bins.splat_ids[first + (entry < n ? entry : n - 1)];
    const SplatShape<float> shape = make_splat_shape(load_place(blend.splats, id), load_conic(blend.splats, id));
    const Reach<float> reach = evaluate_reach(shape, center_x, center_y);
    const bool contributes = reach.contributes && entry < n;
    if (__ballot_sync(kFullWarp, contributes) == 0) continue;

    if (keep_states) {
      PixelState<float> state{transmittance, warp_sum(part.red), warp_sum(part.green), warp_sum(part.blue),
                              warp_sum(part.depth)};
      if (lane == 0) store_state(args.buckets, blend.grid, tile, group, at.index, state);
    }
    const float alpha = contributes ? evaluate_alpha(reach.power).alpha : 0.0f;
    // A splat that does not contribute lets all light through: 1 - 0.
    const float passed = warp_prefix_product(1 - alpha);
    float before = __shfl_up_sync(kFullWarp, passed, 1);
    before = lane == 0 ? transmittance : transmittance * before;
    const float after = transmittance * passed;
    const unsigned saturating = __ballot_sync(kFullWarp, contributes && after < kTransmittanceMin);
    const int stop = saturating != 0 ? __ffs(saturating) - 1 : kWarpSize;
    const bool accepted = contributes && lane < stop;
    if (accepted) {
      const float4 color = load_color(blend.splats, id).v;
      const float weight = before * alpha;
      part.red += weight * color.x;
      part.green += weight * color.y;
      part.blue += weight * color.z;
      part.depth += weight * __ldg(&blend.splats[id].depth);
    }
    const unsigned blended = __ballot_sync(kFullWarp, accepted);
    if (blended != 0) last_blended = group + 31 - __clz(blended);
    if (saturating != 0) {
      transmittance = __shfl_sync(kFullWarp, before, stop);
      break;
    }
    transmittance = __shfl_sync(kFullWarp, after, kWarpSize - 1);
  }
  const PixelState<float> pixel{transmittance, warp_sum(part.red), warp_sum(part.green), warp_sum(part.blue),
                                warp_sum(part.depth)};
  if (lane == 0) store_pixel(blend, at, pixel, last_blended);
}

/// The next task of the pool, for all threads of the block. Two barriers: the ticket is there; everyone has read it.
__device__ __forceinline__ std::int32_t take_task(std::int32_t* next_task, std::int32_t& ticket) {
  __syncthreads();
  if (threadIdx.x == 0) ticket = atomicAdd(next_task, 1);
  __syncthreads();
  return ticket;
}

}  // namespace b3dgs::cuda
