#include "app/bench/step_floor.h"

#include "core/check.h"
#include "core/print.h"
#include "model/formats/splat_cloud.h"

namespace b3dgs {
namespace {

constexpr double kReachableBandwidth = 0.875;  // share of the peak
constexpr double kTransfersPerCycle = 2, kBitsPerByte = 8;
constexpr double kInstructionsPerCycle = 4;  // warp instructions of a multiprocessor: one per scheduler
constexpr double kLanes = 32;                // threads of a warp

// Typical of outdoor scenes.
constexpr double kVisibleShare = 0.4, kTilesPerSplat = 2.25;

}  // namespace

std::optional<GpuRates> reachable_rates(const GpuSpecs& gpu) {
  GpuRates rates;  // 1 kHz is one cycle per ms
  rates.bytes_per_ms =
      kReachableBandwidth * kTransfersPerCycle * gpu.memory_clock_khz * gpu.memory_bus_bits / kBitsPerByte;
  rates.warp_instructions_per_ms = kInstructionsPerCycle * gpu.n_multiprocessors * gpu.clock_khz;
  if (rates.bytes_per_ms <= 0 || rates.warp_instructions_per_ms <= 0) return std::nullopt;
  return rates;
}

std::optional<double> step_floor_ms(Stage stage, const StepSize& size, const GpuRates& rates) {
  const auto ms = [&](double bytes, double warp_instructions = 0) {
    return bytes / rates.bytes_per_ms + warp_instructions / rates.warp_instructions_per_ms;
  };
  const auto n = static_cast<double>(size.n_gaussians);
  const double n_visible = kVisibleShare * n, n_pairs = kTilesPerSplat * n_visible;
  // Floats of a Gaussian without its SH coefficients above degree 0: mean, scale, quaternion, opacity and SH degree 0.
  constexpr double kFloats = 14;
  // Bytes of an Adam update of one float: parameter and two moments, each read and written.
  constexpr double kUpdate = 24;
  // SH coefficients above degree 0 are updated when a view sees the Gaussian. The record of the deferred updates has
  // 32 bytes per Gaussian, of which half is written back.
  constexpr double kDeferredRecord = 32;
  const double n_rest = 3 * sh_coefficient_count(size.sh_degree) - 3, record = n_rest > 0 ? kDeferredRecord : 0;
  // Per pixel of an evenly filled image: bytes stored for the backward pass, instructions of the forward pass, and
  // pairs that the backward pass visits and that contribute to the pixel.
  constexpr double kStateBytes = 128, kForwardInstructions = 110, kPairsVisited = 400, kPairsBlended = 70;
  switch (stage) {
    case Stage::kProject:  // all means; of visible Gaussians: parameters, deferred updates of SH, the splat written
      return ms(12 * n + (4 * kFloats + kUpdate * n_rest + 1.5 * record + 48) * n_visible);
    case Stage::kBin:  // sort by depth; pairs written, sorted by tile and read
      return ms(72 * n_visible + 34 * n_pairs);
    case Stage::kBlendForward:
      return ms(kStateBytes * size.n_pixels, kForwardInstructions * size.n_pixels);
    case Stage::kLoss:  // images, nine maps between the two kernels, gradient
      return ms(110 * size.n_pixels, 1200 / kLanes * size.n_pixels);
    case Stage::kBlendBackward:
      return ms(kStateBytes * size.n_pixels, (28 * kPairsVisited + 22 * kPairsBlended) / kLanes * size.n_pixels);
    case Stage::kOptimizer:  // backward projection, which reads the SH coefficients; update of all other parameters
      return ms((104 + 4 * n_rest + record) * n_visible + kUpdate * kFloats * n);
    case Stage::kProjectBackward:
    case Stage::kUpload:
    case Stage::kDensify:
      return std::nullopt;
  }
  return std::nullopt;
}

std::string step_floor_assumptions(const GpuSpecs& gpu, const GpuRates& rates) {
  return detail::concat(
      "computed for ", gpu.name, ", not measured: ", print_to_string("%.2f", 1e-9 * rates.bytes_per_ms),
      " TB/s (7/8 of the peak memory bandwidth) and ", print_to_string("%.3g", 1e3 * rates.warp_instructions_per_ms),
      " warp instructions/s (4 per clock cycle and multiprocessor), without idle time; 40 % of the Gaussians visible, "
      "2.25 tiles per splat; blending work per pixel as in an evenly filled image");
}

}  // namespace b3dgs
