#include "train/density/density_strategy.h"

#include <array>
#include <string_view>

#include "core/check.h"
#include "train/density/strategies/strategies.h"

namespace b3dgs {
namespace {

struct StrategyRow {
  std::string_view name;
  std::unique_ptr<DensityStrategy> (*make)(const TrainConfig& config, double extent);
};

constexpr std::array kStrategies{
    StrategyRow{kDefaultStrategy, make_default_strategy},
    StrategyRow{"mcmc", make_mcmc_strategy},
    StrategyRow{"budget", make_budget_strategy},
};

constexpr bool has_a_row_for_each_name() {
  if (kStrategies.size() != kDensityStrategies.size()) return false;
  for (std::size_t i = 0; i < kStrategies.size(); ++i) {
    if (kStrategies[i].name != kDensityStrategies[i]) return false;
  }
  return true;
}
static_assert(has_a_row_for_each_name(), "the table of names in src/config has the same rows");

}  // namespace

DensityStatistics DensityStrategy::make_statistics(std::int64_t n_gaussians, torch::Device device) const {
  return make_density_statistics(n_gaussians, device);
}

void DensityStrategy::end_round(int, DensityStatistics& statistics) const {
  for (torch::Tensor* column : statistics.all()) column->zero_();
}

std::unique_ptr<DensityStrategy> make_density_strategy(const TrainConfig& config, double extent) {
  for (const StrategyRow& row : kStrategies) {
    if (config.strategy == row.name) return row.make(config, extent);
  }
  throw LogicError("unknown density strategy: " + config.strategy);
}

}  // namespace b3dgs
