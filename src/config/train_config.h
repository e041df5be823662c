// The values of the training options. Defaults are those of the original 3DGS code unless a comment says otherwise.
// `b3dgs train` starts from a preset (option_layers.h), not from these alone. train_options.h has the options' names,
// ranges and help texts.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "config/choices.h"
#include "raster/kernels.h"

namespace b3dgs {

/// Replaces a kernel name: choose by timing.
inline constexpr const char* kAdaptive = "adaptive";
/// The same with the paper's kernels and its rule (KernelPolicy::kPublished).
inline constexpr const char* kPublishedKernel = "published";

/// The values of --preset. presets.cpp has their options. The first one changes nothing.
inline constexpr const char* kPresetNames[] = {"inria", "fast", "quality", "best"};

// Members are in the order of the options. NOLINTNEXTLINE(clang-analyzer-optin.performance.Padding)
struct TrainConfig {
  // Input and output
  std::string source_path;
  std::string model_path;
  std::string images = "images";
  int resolution = -1;
  bool eval = false;
  std::string init_ply;
  std::string depths;
  std::string lenses = "auto";
  std::string masks;
  bool invert_masks = false;
  MaskMode mask_mode = MaskMode::kIgnore;
  std::string device = "auto";
  double gpu_memory_gb = 0;  // 0: all free memory
  double host_memory_gb = -1;

  // Model and image
  int sh_degree = 3;
  bool white_background = false;
  bool random_background = false;
  bool antialiasing = false;
  double near_plane = 0.2;  // kTypicalDepth (scene/cameras/coordinate_frame.h) is 5

  // Schedule
  std::string preset = kPresetNames[0];
  double steps_scaler = 1;  // always 1 in a config in use (OptionLayers), because it has been applied
  int iterations = 30000;
  int max_epochs = 0;  // 0 = no limit; commands apply it with limit_epochs() (schedule.h), Trainer does not
  int batch = 1;
  std::int64_t seed = 0;
  std::vector<int> test_iterations{7000, 30000};
  std::vector<int> save_iterations{7000, 30000};
  std::vector<int> checkpoint_iterations{};
  double checkpoint_minutes = 10;  // of training time
  int coarse_scale = 1;            // 1: full size throughout
  int coarse_until = 15000;        // as in DashGaussian, the end of densification

  // Learning rates
  double position_lr_init = 0.00016;     // times the scene extent
  double position_lr_final = 0.0000016;  // times the scene extent
  int position_lr_max_steps = 30000;
  double lr_final_scale = 1;
  int lr_decay_from_iter = 0;
  int lr_decay_from_epoch = 0;
  double feature_lr = 0.0025;  // of SH degree 0
  double feature_rest_divisor = 20;
  double opacity_lr = 0.025;  // 0.05 in early versions of the original code
  double scaling_lr = 0.005;
  double rotation_lr = 0.001;
  bool pose_opt = false;

  // Loss
  double lambda_dssim = 0.2;
  double opacity_reg = 0;  // times the mean opacity of the visible Gaussians
  double scale_reg = 0;    // times their mean scale, in units of extent / 5
  double sh_decay = 0;     // times the learning rate of SH degrees above 0; optimizer/sh_decay.h
  double depth_l1_weight_init = 1;
  double depth_l1_weight_final = 0.01;

  // Appearance of each photograph
  bool exposure = false;
  double exposure_lr_init = 0.003;
  double exposure_lr_final = 0.00003;  // original code: 0.01 to 0.001, with which the transforms do not converge
  bool bilateral_grid = false;
  bool train_test_exp = false;

  // Density control
  Strategy strategy = Strategy::kDefault;
  int densify_from_iter = 500;     // exclusive: first round at 600
  int densify_until_iter = 15000;  // exclusive: last round at 14900
  int densification_interval = 100;
  double densify_grad_threshold = 0.0002;  // dL/d(projected centre), normalised device coordinates
  double percent_dense = 0.01;             // of the scene extent: larger Gaussians are split, smaller ones cloned
  int opacity_reset_interval = 3000;       // with white_background also at densify_from_iter; with budget: removals
  int sh_increase_interval = 1000;
  std::int64_t max_gaussians = 0;  // 0 = no limit, unless gaussians_per_pixel sets one
  double gaussians_per_pixel = 0;  // limit per pixel of one photograph
  // For strategy budget:
  int score_views = 20;  // before each round
  double prune_weight = 0.03;
  std::string crop;  // region to train in detail; empty: all

  // Rasterizer
  std::string kernel = kAdaptive;
  int kernel_check_interval = 1000;  // as in the paper
  Culling culling = Culling::kEllipse;
  bool deterministic = false;
  int threads = 0;  // 0 = all cores

  // The following are not options and not in files, but constants that tests and compare change. image_cache_gb limits
  // the photographs cached on the GPU. -1 means up to half of the free GPU memory, which leaves the other half to the
  // Gaussians. A few hundred photographs at the default 1600 px take 1 to 3 GB. The cache affects only speed, because
  // photographs outside it are uploaded ahead of use.
  double image_cache_gb = -1;
  int checkpoint_interval = 0;  // iterations; 0: only checkpoint_iterations
  int keep_checkpoints = 2;
  int stats_interval = 1000;      // load statistics in train.jsonl every N iterations; 0: never
  double pose_opt_lr = 0.0005;    // rad, and of the scene extent; decays to a hundredth over position_lr_max_steps
  double bilateral_grid_tv = 10;  // weight of the total variation
  double prune_opacity = 0.005;
  // The original code intends to prune Gaussians with a radius above 20 px, but zeroes the radii before testing them
  // (its issue 123), so it never prunes by screen size. 0 does the same, and 20 is the intended rule.
  double prune_screen_size = 0;  // px
  double init_opacity = 0.1;
  double init_scale = 1;    // times the root mean square distance to the 3 nearest neighbours
  double noise_lr = 50000;  // for mcmc, times the learning rate of the means
};

/// Returns whether depth maps are part of the loss.
inline bool uses_depths(const TrainConfig& config) {
  return !config.depths.empty() && (config.depth_l1_weight_init > 0 || config.depth_l1_weight_final > 0);
}

/// Returns whether the kernel is chosen by timing.
inline bool chooses_kernel(const TrainConfig& config) {
  return config.kernel == kAdaptive || config.kernel == kPublishedKernel;
}

}  // namespace b3dgs
