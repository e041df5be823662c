// Trainings with every feature that changes the result. Requirements for all of them (exact resume, any number of
// threads, any number of processes, a GPU) are tested once with these, instead of feature by feature.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "core/config.h"
#include "support/train/appearance.h"
#include "support/train/depth_maps.h"
#include "support/train/training.h"

namespace b3dgs::test {

/// Views of two sizes, with masks, gains and tints, and all but one with a depth map.
struct FeatureScene {
  explicit FeatureScene(const std::filesystem::path& depth_maps) : scene(make_jittered_scene()) {
    GaussianTensors truth;
    make_tiny_scene({}, &truth);
    add_depth_maps(scene, truth, depth_maps, 1e-5, 0);
    std::filesystem::remove(depth_maps / "view3.png");
  }
  Scene scene;
};

/// The features that exclude each other: strategy, views per step, and model of the photographs' colours.
struct FeatureRow {
  Strategy strategy;
  int batch;
  bool has_grid;  // otherwise exposures

  std::string name() const { return name_of(strategy) + std::to_string(batch); }
};

inline constexpr FeatureRow kFeatureRows[] = {{Strategy::kDefault, 1, false}, {Strategy::kMcmc, 1, true},
                                              {Strategy::kBudget, 1, false},  {Strategy::kDefault, 3, true},
                                              {Strategy::kMcmc, 3, false},    {Strategy::kBudget, 3, true}};

/// Makes a training of 23 iterations, so that the last step of three views has only two. Checkpoints come before
/// anything happens, around rounds of density control (10, 15, 20), among the scored steps before them, at an opacity
/// reset, and after the last round.
inline TrainConfig every_feature(const FeatureRow& row, const std::filesystem::path& depth_maps) {
  const bool is_budget = row.strategy == Strategy::kBudget, is_mcmc = row.strategy == Strategy::kMcmc;
  TrainConfig config = is_budget ? eventful_budget_config() : eventful_config();
  config.strategy = row.strategy;
  config.iterations = 23;
  config.batch = row.batch;
  config.max_gaussians = is_budget ? 600 : is_mcmc ? 500 : 0;
  if (is_budget) config.crop = "0.4,0,0,0.5";
  config.exposure = !row.has_grid;
  config.bilateral_grid = row.has_grid;
  config.pose_opt = config.antialiasing = true;
  config.depths = depth_maps.string();
  config.opacity_reg = config.scale_reg = 0.01;
  config.coarse_scale = 3;
  config.coarse_until = 40;  // a third of the size, then half of it, then full size
  if (is_mcmc) {             // noise moves Gaussians that are nearly transparent
    config.init_opacity = 0.05;
    config.prune_opacity = 0.045;
    config.noise_lr = 500000;
  }
  config.checkpoint_iterations = {3, 7, 10, 12, 13, 15, 20, 21};
  config.keep_checkpoints = 100;
  return config;
}

}  // namespace b3dgs::test
