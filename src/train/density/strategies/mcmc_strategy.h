// Strategy mcmc (Kheradmand et al. 2024, "3D Gaussian Splatting as Markov Chain Monte Carlo"): the number of Gaussians
// grows by a fixed part per round up to --max_gaussians. Those that have become transparent move to opaque ones instead
// of being removed, in a way that keeps the image, and noise on the means lets them explore. No gradient threshold, no
// opacity reset.
#pragma once

#include <cstdint>
#include <memory>

#include "config/train_config.h"
#include "raster/torch/gaussian_tensors.h"
#include "train/density/density_strategy.h"

namespace b3dgs {

/// `extent`: the scene extent, world units.
std::unique_ptr<DensityStrategy> make_mcmc_strategy(const TrainConfig& config, double extent);

// Its parts, as functions of their arguments alone.

struct McmcRule {
  double prune_opacity = 0;        // Gaussians of at most this opacity are dead
  double growth = 0;               // of the count
  std::int64_t max_gaussians = 0;  // 0 = no limit
};

/// One round. First each dead Gaussian is replaced by a copy of a live one, drawn in proportion to opacity; then copies
/// are added, drawn in the same way, up to `growth` times the count. All copies of a Gaussian, itself included, get the
/// opacity and scales of mcmc_math.h and zero moments. The round counts a moved Gaussian as pruned and cloned. Without
/// live Gaussians the edit changes nothing. Independent of the number of threads.
DensityRound plan_mcmc_round(const GaussianTensors& gaussians, const McmcRule& rule, std::int64_t seed, int iteration);

/// Adds noise to the means (mcmc_math.h); `rate` is --noise_lr times the learning rate of the means. Allocates nothing.
void add_mean_noise(GaussianTensors& gaussians, double rate, std::int64_t seed, int iteration);

}  // namespace b3dgs
