#include "app/bench/step_floor.h"

#include "model/formats/splat_cloud.h"

namespace b3dgs {
namespace {

constexpr double kBytesPerMs = 4.3e9, kWarpInstructionsPerMs = 1.045e9;  // of an H200, as far as programs get
constexpr double kSeenShare = 0.4, kTilesPerSplat = 2.25;                // of outdoor scenes
constexpr double kLanes = 32;

double ms(double bytes, double warp_instructions = 0) {
  return bytes / kBytesPerMs + warp_instructions / kWarpInstructionsPerMs;
}

}  // namespace

std::optional<double> step_floor_ms(Stage stage, const StepSize& size) {
  const auto n = static_cast<double>(size.n_gaussians);
  const double n_seen = kSeenShare * n, n_pairs = kTilesPerSplat * n_seen;
  // Means, scales, quaternion, opacity and the harmonic of degree 0; the other harmonics, and the record of the steps
  // that they owe, of which half is written back. A step reads and writes parameter and two moments.
  constexpr double kFloats = 14, kStep = 24, kOwed = 32;
  const double n_rest = 3 * sh_coefficient_count(size.sh_degree) - 3, owed = n_rest > 0 ? kOwed : 0;
  // Per pixel of an evenly filled image: what a pixel stores for the backward pass, the pairs that are looked at and
  // the pairs that contribute.
  constexpr double kStateBytes = 128, kForwardInstructions = 110, kPairsLookedAt = 400, kPairsBlended = 70;
  switch (stage) {
    case Stage::kProject:  // means of all; the parameters of those that are seen, their harmonics' steps, their splats
      return ms(12 * n + (4 * kFloats + kStep * n_rest + 1.5 * owed + 48) * n_seen);
    case Stage::kBin:  // depth sort, and pairs written, sorted by tile and read
      return ms(72 * n_seen + 34 * n_pairs);
    case Stage::kBlendForward:
      return ms(kStateBytes * size.n_pixels, kForwardInstructions * size.n_pixels);
    case Stage::kLoss:  // images, nine maps between the two kernels, gradient
      return ms(110 * size.n_pixels, 1200 / kLanes * size.n_pixels);
    case Stage::kBlendBackward:
      return ms(kStateBytes * size.n_pixels, (28 * kPairsLookedAt + 22 * kPairsBlended) / kLanes * size.n_pixels);
    case Stage::kOptimizer:  // the projection's backward pass, which reads harmonics; the step of all but these
      return ms((104 + 4 * n_rest + owed) * n_seen + kStep * kFloats * n);
    case Stage::kProjectBackward:
    case Stage::kUpload:
    case Stage::kDensify:
      return std::nullopt;
  }
  return std::nullopt;
}

}  // namespace b3dgs
