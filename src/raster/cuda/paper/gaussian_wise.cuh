// The body of gaussian-wise and combined: a warp blends one pixel, 32 Gaussians at a time, a lane each (Algorithm 6 of
// the paper). The transmittance in front of each lane is a prefix product of 1 - alpha over the lanes below it. One
// thread would need 32 dependent steps for that.
//
// The printed algorithm adds Gaussians at and behind the one that finishes the pixel, multiplies by 1 - alpha of
// Gaussians that do not contribute, weights with the transmittance behind a Gaussian, and restarts the sums in each
// group. This code does what the text of the paper means, so that the image is that of naive.
#pragma once

#include "raster/cuda/paper/patch.cuh"

namespace b3dgs::cuda {

/// A pixel that a warp blends. Transmittance, last and finished are the same in all lanes. Colour and depth are the
/// lane's part of the sums.
struct WarpPixel {
  float transmittance = 1;
  std::int32_t last = -1;  // position in the list of the last splat blended
  bool is_finished = false;
  float4 color_depth{0, 0, 0, 0};
};

/// Blends entry group + lane of each lane, from a batch of `n` entries that starts at list position `first`. The pixel
/// must not be finished.
__device__ __forceinline__ void blend_group(const BlendForwardArgs& blend, const StagedShapes& batch, int group, int n,
                                            std::int32_t first, float center_x, float center_y, WarpPixel& pixel) {
  const int j = group + lane_id();
  bool contributes = false;
  float alpha = 0;  // of a splat that does not contribute, so its factor is 1
  if (j < n) {
    const Footprint<float> footprint = evaluate_footprint(batch.shape(j), center_x, center_y);
    contributes = footprint.contributes;
    if (contributes) alpha = evaluate_alpha(footprint.power).alpha;
  }
  if (!__any_sync(kFullWarp, contributes)) return;
  const float after = pixel.transmittance * warp_prefix(1 - alpha, [](float a, float b) { return a * b; });
  float before = __shfl_up_sync(kFullWarp, after, 1);
  if (lane_id() == 0) before = pixel.transmittance;
  // The first lane that would bring the transmittance below 1e-4 finishes the pixel.
  const unsigned saturating = __ballot_sync(kFullWarp, contributes && is_saturated(after));
  const int stop = saturating != 0 ? __ffs(static_cast<int>(saturating)) - 1 : kWarpSize;
  const bool is_blended = contributes && lane_id() < stop;
  if (is_blended) {
    const float4 color = batch.color_depth(blend.splats, j);
    const float weight = before * alpha;
    float4& sum = pixel.color_depth;
    sum = make_float4(sum.x + weight * color.x, sum.y + weight * color.y, sum.z + weight * color.z,
                      sum.w + weight * color.w);
  }
  const unsigned blended = __ballot_sync(kFullWarp, is_blended);
  if (blended != 0) pixel.last = first + group + kWarpSize - 1 - __clz(static_cast<int>(blended));
  pixel.is_finished = saturating != 0;
  pixel.transmittance =
      pixel.is_finished ? __shfl_sync(kFullWarp, before, stop) : __shfl_sync(kFullWarp, after, kWarpSize - 1);
}

/// Blends all groups of a batch, until the pixel is finished.
__device__ __forceinline__ void blend_batch(const BlendForwardArgs& blend, const StagedShapes& batch, int n,
                                            std::int32_t first, float center_x, float center_y, WarpPixel& pixel) {
  for (int group = 0; group < n && !pixel.is_finished; group += kWarpSize) {
    blend_group(blend, batch, group, n, first, center_x, center_y, pixel);
  }
}

}  // namespace b3dgs::cuda
