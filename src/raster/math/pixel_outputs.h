// Outputs of a pixel: its part of the image, and its part of the scores of Gaussians (ScoreArgs).
#pragma once

#include <cstdint>

#include "core/vec.h"
#include "raster/args.h"
#include "raster/constants.h"

namespace b3dgs {

/// A pixel after all of its splats are blended.
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

// Weights and errors are added to scores as integers, so that sums do not depend on the order of their terms. They are
// the same for any schedule, on CPU and GPU.

inline constexpr int kScoreBits = 24;
inline constexpr float kScoreUnits = static_cast<float>(1 << kScoreBits);  // units in a value of 1
/// The largest number of units that one pixel adds to a sum. Weights are at most kAlphaMax, and errors at most 1.
// NOLINTNEXTLINE(bugprone-incorrect-roundings): as score_units()
inline constexpr std::uint32_t kScoreMax = static_cast<std::uint32_t>(kAlphaMax * kScoreUnits + 0.5f);

/// Clamps an error to [0, 1]. NaN becomes 0.
B3DGS_HD float clamp_error(float error) {
  return error > 0 ? (error < 1 ? error : 1.0f) : 0.0f;
}

/// Converts a value within [0, kAlphaMax] to units, rounded to nearest.
B3DGS_HD std::uint32_t score_units(float value) {
  // NOLINTNEXTLINE(bugprone-incorrect-roundings): not negative, and the same bits on a GPU
  return static_cast<std::uint32_t>(value * kScoreUnits + 0.5f);
}

/// Adds the sums of a splat to the entries of its Gaussian.
B3DGS_HD void add_scores(const ScoreSums& sums, const ScoreArrays& out, std::int64_t gaussian) {
  constexpr double kUnit = 1.0 / (1 << kScoreBits);
  out.error_sum[gaussian] += static_cast<float>(static_cast<double>(sums.error) * kUnit);
  if (out.weight_sum != nullptr) {
    out.weight_sum[gaussian] += static_cast<float>(static_cast<double>(sums.weight) * kUnit);
  }
  if (sums.max_weight > out.max_weight[gaussian]) out.max_weight[gaussian] = sums.max_weight;
  out.n_views[gaussian] += 1;
}

}  // namespace b3dgs
