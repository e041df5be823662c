// A blended pixel to the output arrays of the forward pass.
#pragma once

#include <cstdint>

#include "core/vec.h"
#include "raster/args.h"

namespace b3dgs {

/// A pixel once all of its splats are blended.
struct BlendedPixel {
  float red, green, blue;  // without the background
  float depth;
  float transmittance;  // final, not negative
  std::int32_t last;    // position in the tile's list of the last splat blended, -1 if none
};

/// Adds the background to pixel (x, y) and writes its outputs.
B3DGS_HD void store_blended(const BlendForwardArgs& args, std::int32_t x, std::int32_t y, const BlendedPixel& pixel) {
  const std::int64_t p = std::int64_t{y} * args.grid.image_width + x;
  const float t = pixel.transmittance;
  args.out.color[3 * p] = pixel.red + t * args.background.x;
  args.out.color[3 * p + 1] = pixel.green + t * args.background.y;
  args.out.color[3 * p + 2] = pixel.blue + t * args.background.z;
  args.out.depth[p] = pixel.depth;
  args.out.alpha[p] = 1 - t;
  args.transmittance[p] = t;
  args.last_ids[p] = pixel.last;
}

}  // namespace b3dgs
