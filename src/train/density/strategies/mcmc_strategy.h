// Strategy mcmc (Kheradmand et al. 2024, "3D Gaussian Splatting as Markov Chain Monte Carlo"): the number of Gaussians
// grows by a fixed fraction per round up to --max_gaussians. Gaussians that have become transparent move to opaque ones
// instead of being removed, in a way that preserves the image, and noise on the means lets them explore. There is no
// gradient threshold and no opacity reset.
#pragma once

#include <cstdint>
#include <memory>

#include "config/train_config.h"
#include "raster/torch/gaussian_tensors.h"
#include "train/density/density_strategy.h"

namespace b3dgs {

/// `extent`: the scene extent, world units.
std::unique_ptr<DensityStrategy> make_mcmc_strategy(const TrainConfig& config, double extent);

// The strategy's parts, as stateless functions that tests can call.

struct McmcRule {
  double prune_opacity = 0;        // Gaussians of at most this opacity are dead
  double growth = 0;               // fraction of the number of Gaussians to add
  std::int64_t max_gaussians = 0;  // 0 = no limit
};

/// One round. First each dead Gaussian is replaced by a copy of a live one, drawn in proportion to opacity; then
/// `growth` times the number of Gaussians are added as further copies, drawn in the same way, within max_gaussians. All
/// copies of a Gaussian, itself included, get the opacity and scales of mcmc_math.h and zero Adam moments. A moved
/// Gaussian counts as one pruned and one cloned. Without live Gaussians, the edit changes nothing. The result does not
/// depend on the number of threads.
DensityRound plan_mcmc_round(const GaussianTensors& gaussians, const McmcRule& rule, std::int64_t seed, int iteration);

/// Adds noise to the means (mcmc_math.h); `rate` is noise_lr times the learning rate of the means. `model_rows` as
/// DensityStrategy::after_step() has it: the noise of a Gaussian is that of its row of the model. Allocates nothing.
void add_mean_noise(GaussianTensors& gaussians, double rate, std::int64_t seed, int iteration,
                    const torch::Tensor& model_rows = {});

}  // namespace b3dgs
