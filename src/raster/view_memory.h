// Forecasts the GPU memory that the rasterizer needs for a view. The sizes mirror the buffers of cuda/passes.h and
// cuda/cuda_backend.cpp, and a test compares them with the buffers. cuda/README.md has them as a table.
#pragma once

#include <algorithm>

#include "raster/args.h"

namespace b3dgs {

/// Memory in bytes. A buffer may be up to a quarter larger if there is enough memory.
struct ViewMemory {
  double per_gaussian = 0;
  double per_pair = 0;  // per (tile, splat) pair
  double of_image = 0;  // regardless of how many Gaussians the view sees
  double bytes(double n_gaussians, double n_pairs) const { return per_gaussian * n_gaussians + per_pair * n_pairs; }
};

inline ViewMemory view_memory(const RenderSettings& settings, const CameraView& view) {
  constexpr double kBucket = 128, kSegment = 512;  // list entries: kBucketEntries, ListCut::kMaxLog2
  const TileShape tile = settings.tile_shape();
  const std::int64_t n_tiles = (std::int64_t{view.width} + tile.width - 1) / tile.width *
                               ((std::int64_t{view.height} + tile.height - 1) / tile.height);
  // Only our own kernels store bucket parts, cut lists into segments, or sum in a fixed order.
  const double tile_pixels =
      family_of(settings.kernel) == KernelFamily::kOwn ? static_cast<double>(tile.width) * tile.height : 0;
  const bool keeps = settings.keep_for_backward, keeps_slots = keeps && settings.deterministic;
  // Splat, extent and radius, then gradient, then first slot.
  const double per_splat = 48 + 8 + 4 + (keeps ? 48 : 0) + (keeps_slots ? 8 : 0);
  // Sorting and segmented blending use the same scratch memory in turn (PassScratch). So does the backward pass, which
  // needs no more.
  const double sorting = 2 * 8;                                         // keys, and the output of merged runs
  const double segments = 1.5 * tile_pixels / kSegment * (4 + 16 + 4);  // transmittance, colour and depth, last
  const double bucket_parts = keeps ? tile_pixels * (settings.depth_gradient ? 20 : 16) : 0;
  const double segment_fronts = keeps ? 1.5 * tile_pixels / kSegment * 4 : 0;
  const double fixed_order = keeps_slots ? 8 + 48 : 0;  // slot and gradient of each pair
  const double lists = 4 + 4 / kBucket;                 // splat, tile of each bucket
  // For each pixel: transmittance and last splat. For each tile: the start of its list, buckets, segments and runs, its
  // rank by length, two counters in sectors of their own, and its last bucket, which is not full.
  const double of_image =
      8.0 * view.width * view.height + static_cast<double>(n_tiles) * (8 + 8 + 4 * 3 + 2 * 32 + bucket_parts);
  return {splats_per_gaussian(view.lens) * per_splat,
          lists + bucket_parts / kBucket + segment_fronts + fixed_order + std::max(sorting, segments), of_image};
}

}  // namespace b3dgs
