#include "train/density/density_strategy.h"

#include "core/check.h"
#include "train/density/original_strategy.h"

namespace b3dgs {
namespace {

struct StrategyRow {
  const char* name;
  std::unique_ptr<DensityStrategy> (*make)(const TrainConfig& config, double extent);
};

constexpr StrategyRow kStrategies[] = {
    {kDefaultDensityStrategy, make_original_strategy},
};

}  // namespace

DensityStatistics DensityStrategy::make_statistics(std::int64_t n_gaussians, torch::Device device) const {
  return make_density_statistics(n_gaussians, device);
}

std::unique_ptr<DensityStrategy> make_density_strategy(const std::string& name, const TrainConfig& config,
                                                       double extent) {
  for (const StrategyRow& row : kStrategies) {
    if (name == row.name) return row.make(config, extent);
  }
  throw LogicError("unknown density strategy: " + name);
}

}  // namespace b3dgs
