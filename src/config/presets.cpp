#include "config/presets.h"

namespace b3dgs {

const std::vector<OptionRow>& presets() {
  static const std::vector<OptionRow> kPresets{
      {"original", "the options of the original 3DGS code", {}},
      // A fifth of the schedule of strategy balanced.
      {"fast",
       "a short training with few Gaussians",
       {{"strategy", "balanced"},
        {"iterations", "6000"},
        {"position_lr_max_steps", "6000"},
        {"densify_from_iter", "100"},
        {"densify_until_iter", "5000"},
        {"densification_interval", "60"},
        {"sh_increase_interval", "200"},
        {"prune_interval", "600"},
        {"prune_until_iter", "5600"},
        {"coarse_until", "3000"},
        {"skip_from_iter", "3100"},
        {"pose_opt_from_iter", "100"}}},
      // Not measured yet.
      {"quality",
       "strategy balanced with more Gaussians; values not tuned yet",
       {{"strategy", "balanced"},
        {"iterations", "30000"},
        {"position_lr_max_steps", "30000"},
        {"pixels_per_gaussian", "150"}}},
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
      {"balanced",
       "",
       {{"densify_until_iter", "25000"},
        {"densification_interval", "300"},
        {"pixels_per_gaussian", "220"},
        {"position_lr_final", "0.000016"},
        {"opacity_lr", "0.05"},
        {"opacity_reg", "0.005"},
        {"scale_reg", "0.01"},
        {"noise_lr", "0"}}},
  };
  return kStrategyDefaults;
}

}  // namespace b3dgs
