#include "app/bench/bench_scalar_loop.h"

#include <algorithm>
#include <cmath>

#include "raster/constants.h"
#include "raster/math/tiling.h"

namespace b3dgs {

void blend_forward_scalar_loop(const BlendForwardArgs& args) {
  constexpr float kLn2 = 0.693147181f;
  for (std::int32_t tile = 0; tile < args.grid.n_tiles(); ++tile) {
    const Rect rect = tile_pixels(args.grid, tile);
    const std::int64_t first = args.bins.tile_offsets[tile], last = args.bins.tile_offsets[tile + 1];
    for (std::int32_t y = rect.y_begin; y < rect.y_end; ++y) {
      for (std::int32_t x = rect.x_begin; x < rect.x_end; ++x) {
        float transmittance = 1, red = 0, green = 0, blue = 0, depth = 0;
        std::int32_t last_id = -1;
        for (std::int64_t i = first; i < last; ++i) {
          const Splat& splat = args.splats[args.bins.splat_ids[i]];
          const float dx = static_cast<float>(x) + 0.5f - splat.mean_x;
          const float dy = static_cast<float>(y) + 0.5f - splat.mean_y;
          const float sigma =
              kLn2 * (splat.conic_xx * dx * dx + 2 * splat.conic_xy * dx * dy + splat.conic_yy * dy * dy);
          if (sigma < 0) continue;
          const float alpha = std::min(kAlphaMax, std::exp(kLn2 * splat.log2_opacity - sigma));
          if (alpha < kAlphaMin) continue;
          const float next = transmittance * (1 - alpha);
          if (next < kTransmittanceMin) break;
          const float weight = transmittance * alpha;
          red += weight * splat.red;
          green += weight * splat.green;
          blue += weight * splat.blue;
          depth += weight * splat.depth;
          transmittance = next;
          last_id = static_cast<std::int32_t>(i - first);
        }
        const std::int64_t pixel = std::int64_t{y} * args.grid.image_width + x;
        args.out.color[3 * pixel] = red + transmittance * args.background.x;
        args.out.color[3 * pixel + 1] = green + transmittance * args.background.y;
        args.out.color[3 * pixel + 2] = blue + transmittance * args.background.z;
        args.out.depth[pixel] = depth;
        args.out.alpha[pixel] = 1 - transmittance;
        args.transmittance[pixel] = transmittance;
        args.last_ids[pixel] = last_id;
      }
    }
  }
}

}  // namespace b3dgs
