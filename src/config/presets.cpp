#include "config/presets.h"

namespace b3dgs {

const std::vector<OptionRow>& presets() {
  static const std::vector<OptionRow> kPresets{
      {"original", "the options of the original 3DGS code", {}},
      {"fast",
       "a usable model in seconds",
       {{"iterations", "7000"},
        {"position_lr_max_steps", "7000"},
        {"densify_until_iter", "5000"},
        {"sh_increase_interval", "500"}}},
      {"quality",
       "the best images within the original's time",
       {{"iterations", "30000"}, {"position_lr_max_steps", "30000"}}},
  };
  return kPresets;
}

const std::vector<OptionRow>& strategy_defaults() {
  static const std::vector<OptionRow> kStrategyDefaults{
      {"mcmc",
       "",
       {{"opacity_lr", "0.05"},
        {"opacity_reg", "0.01"},
        {"scale_reg", "0.01"},
        {"densify_until_iter", "25000"},
        {"max_gaussians", "1000000"},
        {"init_opacity", "0.5"},
        {"init_scale", "0.1"}}},
      {"balanced", "", {{"opacity_reg", "0.01"}, {"scale_reg", "0.01"}, {"max_gaussians", "200000"}}},
  };
  return kStrategyDefaults;
}

}  // namespace b3dgs
