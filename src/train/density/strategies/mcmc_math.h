// Arithmetic of strategy mcmc (Kheradmand et al. 2024), for one row at a time and the same on CPU and GPU. All arrays
// of a struct are on one device. A Gaussian is dead if its opacity is at most prune_opacity, and otherwise live.
#pragma once

#include <cmath>
#include <cstdint>

#include "core/random.h"
#include "raster/args.h"
#include "raster/math/array_rows.h"
#include "raster/math/covariance.h"

namespace b3dgs {

B3DGS_HD double sigmoid(double logit) {
  return 1 / (1 + std::exp(-logit));
}

/// Returns the weight of a Gaussian in a draw: its opacity in units of 2^-32, at least 1 for live Gaussians and 0 for
/// dead ones. It is an integer, so that sums do not depend on the order of addition. A Gaussian is dead up to the
/// opacity logit `dead_logit`. NaN counts as dead.
B3DGS_HD std::int64_t draw_weight(float logit, float dead_logit) {
  if (!(logit > dead_logit)) return 0;
  const auto weight = static_cast<std::int64_t>(sigmoid(logit) * 0x1p32);
  return weight > 1 ? weight : 1;
}

struct DrawWeightArgs {
  const float* logit_opacities = nullptr;  // [n]
  float dead_logit = 0;
  std::int64_t* out = nullptr;  // [n]
};

B3DGS_HD void write_draw_weight(const DrawWeightArgs& args, std::int64_t i) {
  args.out[i] = draw_weight(args.logit_opacities[i], args.dead_logit);
}

struct DrawArgs {
  std::int64_t n_rows = 0;
  const std::int64_t* sums = nullptr;  // [n_rows] inclusive prefix sums of the weights, the last one above 0
  RandomKey key{};
  std::uint64_t first_number = 0;  // draw i uses random number first_number + i of `key`
  std::int64_t* out = nullptr;     // index of the row for each draw
};

/// Makes draw i, with replacement: chooses a row with probability proportional to its weight.
B3DGS_HD void draw_row(const DrawArgs& args, std::int64_t i) {
  const auto bits = random_bits(args.key, args.first_number + static_cast<std::uint64_t>(i));
  const std::uint64_t word = (static_cast<std::uint64_t>(bits[0]) << 32) | bits[1];
  const double uniform = static_cast<double>(word >> 11) * 0x1p-53;  // in [0, 1)
  const std::int64_t total = args.sums[args.n_rows - 1];
  auto at = static_cast<std::int64_t>(uniform * static_cast<double>(total));
  if (at >= total) at = total - 1;
  // Finds the first row whose sum is above `at`.
  std::int64_t low = 0, high = args.n_rows - 1;
  while (low < high) {
    const std::int64_t middle = low + (high - low) / 2;
    if (args.sums[middle] > at) {
      high = middle;
    } else {
      low = middle + 1;
    }
  }
  args.out[i] = low;
}

// N copies with the same mean replace a Gaussian of opacity o and scales s (equations 8 and 9):
//   o' = 1 - (1 - o)^(1/N)
//   s' = s o / sum_{i=1..N} sum_{k=0..i-1} C(i-1, k) (-1)^k o'^(k+1) / sqrt(k+1)
// Together, the copies have opacity o and look about the same. log_shrink() uses sum_{i=1..N} C(i-1, k) = C(N, k+1).

inline constexpr int kMaxCopies = 51;  // upper limit of N

/// Returns ln s' - ln s for N = n_copies <= kMaxCopies.
B3DGS_HD double log_shrink(double logit, int n_copies) {
  // Limits opacity to 1 - 1e-7, because closer to 1 the terms of alternating sign would cancel each other.
  constexpr double kLargestLogit = 16;
  const double x = logit < kLargestLogit ? logit : kLargestLogit;
  const double log_clear = -std::log1p(std::exp(x));  // ln(1 - o)
  const double each = -std::expm1(log_clear / n_copies);
  double sum = 0, choose = n_copies, power = each;  // C(N, k+1), exact below 2^53; (-1)^k o'^(k+1)
  for (int k = 0; k < n_copies; ++k) {
    sum += choose * power / std::sqrt(k + 1.0);
    choose = choose * (n_copies - k - 1) / (k + 2);
    power *= -each;
  }
  return std::log(sigmoid(x) / sum);
}

/// Returns the logit of o'. Computes o' / (1 - o') = (1 - o)^(-1/N) - 1 instead of o', which may round to 1.
B3DGS_HD double shared_logit(double logit, int n_copies) {
  const double log_clear = logit > 0 ? -logit - std::log1p(std::exp(-logit)) : -std::log1p(std::exp(logit));
  const double ratio = -log_clear / n_copies;
  return ratio > 30 ? ratio : std::log(std::expm1(ratio));  // e^-30 is below half an ulp of a float
}

struct ShareArgs {
  const std::int64_t* rows = nullptr;      // [n] in [0, N): index of the Gaussian that each output copies
  const std::int32_t* n_drawn = nullptr;   // [N] number of copies of each Gaussian beside itself
  const float* logit_opacities = nullptr;  // [N]
  const float* log_scales = nullptr;       // [N, 3]
  float* out_logit_opacities = nullptr;    // [n]
  float* out_log_scales = nullptr;         // [n, 3]
};

/// Writes opacity and scales of output i. A Gaussian without copies keeps its values bit for bit.
B3DGS_HD void share_row(const ShareArgs& args, std::int64_t i) {
  const std::int64_t row = args.rows[i];
  float logit = args.logit_opacities[row];
  Vec3f log_scales = load3(args.log_scales, row);
  if (args.n_drawn[row] > 0) {
    const int n_copies = args.n_drawn[row] < kMaxCopies ? args.n_drawn[row] + 1 : kMaxCopies;
    const double shrink = log_shrink(logit, n_copies);
    log_scales = {static_cast<float>(log_scales.x + shrink), static_cast<float>(log_scales.y + shrink),
                  static_cast<float>(log_scales.z + shrink)};
    logit = static_cast<float>(shared_logit(logit, n_copies));
  }
  args.out_logit_opacities[i] = logit;
  store3(args.out_log_scales, i, log_scales);
}

// Noise on the means lets nearly transparent Gaussians explore the scene (equation 10):
//   mean += rate sigmoid(-100 (o - 0.005)) Sigma eps,   eps ~ N(0, I)

struct MeanNoiseArgs {
  GaussianArrays gaussians{};
  float* means = nullptr;  // the means of `gaussians`, in and out
  RandomKey key{};
  double rate = 0;                           // noise_lr times the learning rate of the means
  float log_bound = 0;                       // log_noise_bound(rate)
  const std::int32_t* model_rows = nullptr;  // [N] index in the whole model, which selects the random numbers; null: i
};

inline constexpr double kNoiseSlope = 100, kNoiseOpacity = 0.005;

/// Returns the logarithm of a bound. If the bound times s^2 e^(-100 (o - 0.005)) is below |x|, where s is the largest
/// scale, noise cannot change a coordinate x: then |noise| < 2^-25 |x|, less than half the distance to the next float.
/// |eps| < 9.6 holds for random_normal(). The factor 1.05 covers rounding in the comparison.
inline float log_noise_bound(double rate) {
  return static_cast<float>(std::log(1.05 * 9.6 * 0x1p25 * rate));
}

/// Adds the noise to Gaussian i. Noise that is too small to change a float is not drawn, which is the case for most
/// Gaussians. Computed in double, so that CPU and GPU differ by one ulp at most.
B3DGS_HD void add_noise_row(const MeanNoiseArgs& args, std::int64_t i) {
  const Vec3f mean = load3(args.means, i), log_scales = load3(args.gaussians.log_scales, i);
  const float logit = args.gaussians.logit_opacities[i];
  const float largest = std::fmax(log_scales.x, std::fmax(log_scales.y, log_scales.z));
  const float nearest = std::fmin(std::fabs(mean.x), std::fmin(std::fabs(mean.y), std::fabs(mean.z)));
  const float opacity = 1 / (1 + std::exp(-logit));
  constexpr auto kSlope = static_cast<float>(kNoiseSlope), kOpacity = static_cast<float>(kNoiseOpacity);
  if (args.log_bound + 2 * largest - kSlope * (opacity - kOpacity) < std::log(nearest)) return;

  const double size = args.rate * sigmoid(-kNoiseSlope * (sigmoid(logit) - kNoiseOpacity));
  const std::int64_t row = args.model_rows == nullptr ? i : args.model_rows[i];
  const auto normal = random_normal(args.key, static_cast<std::uint64_t>(row));
  const Vec4f quat = load4(args.gaussians.quats, i);
  const Mat3<double> m =
      make_shape<double>({log_scales.x, log_scales.y, log_scales.z}, {quat.x, quat.y, quat.z, quat.w}).factor;
  const Vec3<double> noise = m * transpose_times(m, Vec3<double>{normal[0], normal[1], normal[2]});  // Sigma = M M^T
  store3(args.means, i,
         {static_cast<float>(mean.x + size * noise.x), static_cast<float>(mean.y + size * noise.y),
          static_cast<float>(mean.z + size * noise.z)});
}

}  // namespace b3dgs
