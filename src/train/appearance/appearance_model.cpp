#include "train/appearance/appearance_model.h"

#include "train/appearance/bilateral_grid_model.h"
#include "train/appearance/exposure_model.h"

namespace b3dgs {

std::unique_ptr<AppearanceModel> make_appearance_model(const TrainConfig& config, std::int64_t n_views,
                                                       torch::Device device) {
  if (config.bilateral_grid) return std::make_unique<BilateralGridModel>(config, n_views, device);
  if (config.exposure) return std::make_unique<ExposureModel>(config, n_views, device);
  return nullptr;
}

}  // namespace b3dgs
