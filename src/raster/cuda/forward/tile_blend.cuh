// Device functions shared by the blend kernels: loading splats, and writing pixels and bucket parts.
#pragma once

#include "raster/cuda/passes.h"
#include "raster/cuda/warp.cuh"
#include "raster/math/blend.h"
#include "raster/math/pixel_outputs.h"
#include "raster/math/tiling.h"

namespace b3dgs::cuda {

static_assert(kSubTilePixels == kWarpSize, "a lane per pixel of a sub-tile");

// The three 16-byte words of a Splat, each loaded with one instruction.
// First: mean_x, mean_y, log2_opacity, depth
__device__ __forceinline__ float4 load_mean(const Splat* splats, std::int32_t id) {
  return __ldg(reinterpret_cast<const float4*>(splats + id));
}
// Second: conic_xx, conic_xy, conic_yy, gaussian
__device__ __forceinline__ float4 load_conic(const Splat* splats, std::int32_t id) {
  return __ldg(reinterpret_cast<const float4*>(splats + id) + 1);
}
// Third: red, green, blue, clamped
__device__ __forceinline__ float4 load_color(const Splat* splats, std::int32_t id) {
  return __ldg(reinterpret_cast<const float4*>(splats + id) + 2);
}
__device__ __forceinline__ SplatShape<float> make_splat_shape(float4 mean, float4 conic) {
  return {mean.x, mean.y, mean.z, conic.x, conic.y, conic.z};
}

/// A pixel in the image and in its tile.
struct TilePixel {
  std::int32_t x, y;   // in the image, px
  std::int32_t index;  // in the tile, counted row by row
  bool inside;         // inside the image
  __device__ float center_x() const { return static_cast<float>(x) + 0.5f; }
  __device__ float center_y() const { return static_cast<float>(y) + 0.5f; }
};

__device__ __forceinline__ TilePixel tile_pixel(const TileGrid& grid, std::int32_t tile, std::int32_t index) {
  const std::int32_t x = tile % grid.columns * grid.tile.width + index % grid.tile.width;
  const std::int32_t y = tile / grid.columns * grid.tile.height + index / grid.tile.width;
  return {x, y, index, x < grid.image_width && y < grid.image_height};
}

/// Returns the sum of two consecutive parts of a list. `back` was blended with the transmittance behind `front`.
__device__ __forceinline__ PixelState<float> sum_of(const PixelState<float>& front, const PixelState<float>& back) {
  return {back.transmittance, front.red + back.red, front.green + back.green, front.blue + back.blue,
          front.depth + back.depth};
}

/// Writes the pixel's outputs.
__device__ __forceinline__ void store_pixel(const BlendForwardArgs& args, const TilePixel& at,
                                            const PixelState<float>& pixel, std::int32_t last) {
  store_blended(args, at.x, at.y,
                {pixel.red, pixel.green, pixel.blue, pixel.depth, magnitude(pixel.transmittance), last});
}

/// Returns the index in BucketParts of a pixel's part for the bucket that contains list entry `position`.
__device__ __forceinline__ std::int64_t bucket_part_index(const BlendForwardCudaArgs& args, std::int32_t tile,
                                                          std::int64_t position, std::int32_t pixel_index) {
  const TileShape shape = args.blend.grid.tile;
  const std::int64_t bucket = args.buckets.offsets[tile] + position / kBucketEntries;
  return bucket * (shape.width * shape.height) + pixel_index;
}

/// Stores the bucket part of a pixel. part.transmittance is the transmittance behind the bucket.
__device__ __forceinline__ void store_bucket_part(const BlendForwardCudaArgs& args, std::int32_t tile,
                                                  std::int64_t position, std::int32_t pixel_index,
                                                  const PixelState<float>& part) {
  const std::int64_t at = bucket_part_index(args, tile, position, pixel_index);
  args.parts.color[at] = make_float4(magnitude(part.transmittance), part.red, part.green, part.blue);
  if (args.parts.depth != nullptr) args.parts.depth[at] = part.depth;
}

/// Returns the number of entries of a tile's list.
__device__ __forceinline__ std::int32_t list_length(const BinnedSplats& bins, std::int32_t tile) {
  return static_cast<std::int32_t>(bins.tile_offsets[tile + 1] - bins.tile_offsets[tile]);
}

/// Returns whether a splat's box contains a pixel centre of the sub-tile whose upper left pixel centre is (left, top).
__device__ __forceinline__ bool reaches_sub_tile(float mean_x, float mean_y, float2 extent, float left, float top) {
  constexpr float kLastX = kSubTileWidth - 1, kLastY = kSubTileHeight - 1;
  return mean_x + extent.x >= left && mean_x - extent.x <= left + kLastX && mean_y + extent.y >= top &&
         mean_y - extent.y <= top + kLastY;
}

}  // namespace b3dgs::cuda
