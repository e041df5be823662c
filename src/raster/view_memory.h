// GPU memory that a view takes in the rasterizer, for forecasts. The numbers belong to cuda/passes.h and
// cuda/rasterize_cuda.cpp; a test holds them against what the buffers take. README.md has them as a table.
#pragma once

#include <algorithm>

#include "raster/args.h"

namespace b3dgs {

/// Bytes; a buffer takes up to a quarter more where there is room.
struct ViewMemory {
  double per_gaussian = 0;
  double per_splat = 0;  // Gaussian that is seen
  double per_pair = 0;   // (tile, splat)
  double bytes(double n_gaussians, double n_splats, double n_pairs) const {
    return per_gaussian * n_gaussians + per_splat * n_splats + per_pair * n_pairs;
  }
};

inline ViewMemory view_memory(const RenderSettings& settings) {
  constexpr double kBucket = 32, kSegment = 1024;  // entries of a list
  const double tile_pixels = static_cast<double>(settings.tile.width) * settings.tile.height;
  const bool keeps = settings.keep_for_backward, keeps_slots = keeps && settings.deterministic;
  // Splat, extent, radius, number of tiles, bits of the depth; its place in the list of the seen, depth and rank there.
  const double per_gaussian = 48 + 8 + 4 + 4 + 4 + 4 + 4 + 4;
  // Splat and extent in order of depth, sorted depth and index, first slot, CUB's copies; gradient.
  const double per_splat = 48 + 8 + 4 + 4 + 8 + 8 + (keeps ? 48 : 0);
  // What is scratch of one pass is scratch of the others too (PassScratch).
  const double sorting = 2 * (2 + 4) + 2 + (keeps_slots ? 8 : 0);     // tiles and ranks, CUB's copies, slots
  const double segments = 2 * tile_pixels / kSegment * (4 + 16 + 4);  // transmittance, colour and depth, last
  const double ends = keeps ? tile_pixels / kBucket * 8 : 0;          // what lies behind each bucket
  const double parts = keeps ? tile_pixels / kBucket * (settings.depth_gradient ? 20 : 16) : 0;
  const double segment_starts = 2 * tile_pixels / kSegment * 4;
  const double fixed_order = keeps_slots ? 8 + 48 : 0;  // slot and gradient of the pair
  const double lists = 4 + 4 / kBucket;                 // splat, tile of each bucket
  return {per_gaussian, per_splat, lists + parts + segment_starts + fixed_order + std::max({sorting, segments, ends})};
}

}  // namespace b3dgs
