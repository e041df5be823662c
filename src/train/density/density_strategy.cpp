#include "train/density/density_strategy.h"

#include <array>

#include "core/check.h"
#include "train/density/strategies/strategies.h"

namespace b3dgs {
namespace {

// In the order of Strategy.
constexpr std::array kMakers{make_default_strategy, make_mcmc_strategy, make_budget_strategy};
static_assert(kMakers.size() == names_of(Strategy{}).size(), "a strategy for each name");

}  // namespace

GaussianArrays arrays_without_colors(const GaussianTensors& gaussians) {
  for (const torch::Tensor* tensor :
       {&gaussians.means, &gaussians.log_scales, &gaussians.quats, &gaussians.logit_opacities}) {
    B3DGS_CHECK(tensor->is_contiguous(), "density control needs contiguous tensors");
  }
  GaussianArrays arrays;
  arrays.n_gaussians = gaussians.size();
  arrays.means = gaussians.means.data_ptr<float>();
  arrays.log_scales = gaussians.log_scales.data_ptr<float>();
  arrays.quats = gaussians.quats.data_ptr<float>();
  arrays.logit_opacities = gaussians.logit_opacities.data_ptr<float>();
  return arrays;
}

DensityStatistics DensityStrategy::make_statistics(std::int64_t n_gaussians, torch::Device device) const {
  return make_density_statistics(n_gaussians, device);
}

void DensityStrategy::end_round(int, DensityStatistics& statistics) const {
  for (torch::Tensor* column : statistics.all()) column->zero_();
}

std::unique_ptr<DensityStrategy> make_density_strategy(const TrainConfig& config, double extent) {
  return kMakers[static_cast<std::size_t>(config.strategy)](config, extent);
}

}  // namespace b3dgs
