#include "config/presets.h"

namespace b3dgs {

const std::vector<OptionRow>& presets() {
  static const std::vector<OptionRow> kPresets{
      {"original", "the options of the original 3DGS code, for comparison", {}},
      // fast and quality repeat max_epochs: the scaling of the schedule would lower it.
      {"fast",
       "a first look, in a fifth of the iterations of best",
       {{"strategy", "balanced"},
        {"iterations", "6000"},
        {"max_epochs", "400"},
        {"lr_decay_from_epoch", "0"},
        {"gaussians_per_pixel", "0.8"},
        {"prune_weight", "0.01"},
        {"split", "moments"},
        {"score_views", "10"},
        {"scaling_lr", "0.02"},
        {"opacity_reg", "0.002"},
        {"scale_reg", "0.003"},
        {"coarse_scale", "4"},
        {"coarse_until", "2400"}}},
      {"quality",
       "with 100 photographs or more, half of the Gaussians of best",
       {{"strategy", "balanced"}, {"iterations", "24000"}, {"max_epochs", "400"}}},
      {"best",
       "the best picture of 100 photographs or more",
       {{"strategy", "balanced"}, {"iterations", "30000"}, {"gaussians_per_pixel", "2.4"}, {"prune_weight", "0.01"}}},
  };
  return kPresets;
}

const std::vector<OptionRow>& strategy_defaults() {
  static const std::vector<OptionRow> kStrategyDefaults{
      // The schedule of preset original x 0.9, with growth until five sixths of it.
      {"mcmc",
       "",
       {{"iterations", "27000"},
        {"position_lr_max_steps", "27000"},
        {"densify_from_iter", "450"},
        {"densify_until_iter", "22500"},
        {"densification_interval", "90"},
        {"sh_increase_interval", "900"},
        {"coarse_until", "13500"},
        {"max_gaussians", "1000000"},
        {"opacity_lr", "0.05"},
        {"opacity_reg", "0.01"},
        {"scale_reg", "0.01"},
        {"lr_final_scale", "0.3"},
        {"lr_decay_from_iter", "13500"}}},
      {"balanced",
       "",
       {{"iterations", "30000"},  // that of original, too, but here --iterations scales the schedule
        {"max_epochs", "400"},
        {"densify_until_iter", "20000"},
        {"densification_interval", "300"},
        {"gaussians_per_pixel", "1.2"},
        {"position_lr_final", "0.000016"},
        {"opacity_lr", "0.05"},
        {"feature_lr", "0.005"},
        {"feature_rest_divisor", "10"},
        {"rotation_lr", "0.002"},
        {"opacity_reg", "0.005"},
        {"scale_reg", "0.01"},
        {"lr_final_scale", "0.1"},
        {"lr_decay_from_iter", "20000"},
        {"lr_decay_from_epoch", "100"}}},
  };
  return kStrategyDefaults;
}

}  // namespace b3dgs
