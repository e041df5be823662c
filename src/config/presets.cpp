#include "config/presets.h"

namespace b3dgs {

const std::vector<OptionRow>& presets() {
  static const std::vector<OptionRow> kPresets{
      {"original", "the options of the original 3DGS code", {}},
      // Not measured yet: first values for both, from the papers that docs/recipes.md names.
      {"fast",
       "a short training; values not tuned yet",
       {{"strategy", "balanced"},
        {"iterations", "7000"},
        {"position_lr_max_steps", "7000"},
        {"densify_until_iter", "5000"},
        {"sh_increase_interval", "500"},
        {"coarse_scale", "4"},
        {"coarse_until", "3500"},
        {"skip_from_iter", "5200"},
        {"prune_until_iter", "6500"}}},
      {"quality",
       "a limited number of Gaussians, moved to where they are needed; values not tuned yet",
       {{"strategy", "mcmc"},
        {"iterations", "30000"},
        {"position_lr_max_steps", "30000"},
        {"max_gaussians", "500000"}}},
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
