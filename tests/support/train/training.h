// Short trainings, and helpers to compare their results.
#pragma once

#include <gtest/gtest.h>

#include <initializer_list>
#include <string>

#include "core/files/folders.h"
#include "support/files.h"
#include "support/same.h"
#include "support/train/write_checkpoint.h"
#include "train/checkpoint/checkpoint.h"
#include "train/trainer.h"

namespace b3dgs::test {

/// Density control at 10, 15, 20, ... with clones, splits and prunes, opacity resets at 12 and 24, SH degree up at 7.
inline TrainConfig eventful_config() {
  TrainConfig config;
  config.iterations = 20;
  config.seed = 9;
  config.sh_degree = 1;
  config.sh_increase_interval = 7;
  config.densify_from_iter = 5;
  config.densification_interval = 5;
  config.opacity_reset_interval = 12;
  config.densify_grad_threshold = 2e-5;
  config.percent_dense = 0.02;
  config.random_background = true;
  config.test_iterations = config.save_iterations = {};
  config.kernel = "sub-tile";  // a selection by timing would differ from run to run
  return config;
}

/// Strategy budget: rounds at 10, 15, 20, ... with 3 scored steps before each, removals by weight at 20.
inline TrainConfig eventful_budget_config() {
  TrainConfig config = eventful_config();
  config.strategy = Strategy::kBudget;
  config.iterations = 24;
  config.max_gaussians = 200;
  config.densify_until_iter = 22;
  config.score_views = 3;
  config.opacity_reset_interval = 10;
  config.prune_weight = 0.05;
  return config;
}

/// Strategy budget from the 60 Gaussians of learnable_scene() to 150, in rounds from iteration 100 on.
inline TrainConfig growing_budget_config(int iterations, int last_round) {
  TrainConfig config;
  config.strategy = Strategy::kBudget;
  config.iterations = iterations;
  config.densify_from_iter = 100;
  config.densify_until_iter = last_round;
  config.max_gaussians = 150;
  return config;
}

/// Returns a checkpoint's bytes without the duration and ID of the training, and without another key of its header.
inline std::string timeless_bytes(const std::filesystem::path& checkpoint, const std::string& without = "") {
  CheckpointFile file = read_checkpoint_file(checkpoint);
  file.header.erase("elapsed_s");
  file.header.erase("training_id");
  file.header.erase(without);
  const std::filesystem::path copy = checkpoint.string() + ".timeless";
  write_checkpoint_file(copy, file);
  const std::string bytes = read_bytes(copy);
  std::filesystem::remove(copy);
  return bytes;
}

struct Trained {
  TrainResult result;
  std::string ply, checkpoint;  // file contents; the checkpoint is without times
};

/// Replaces the model in the folder, unless it resumes.
inline Trained train(const TrainConfig& config, const Scene& scene, const std::filesystem::path& folder,
                     const std::filesystem::path& resume = {}, const TrainHooks& hooks = {}) {
  if (resume.empty()) {
    for (const char* part : {"point_cloud", "checkpoints"}) remove_tree(folder / part);
  }
  Trainer trainer(finalize(config, scene), scene, ModelFolder(folder), hooks);
  if (!resume.empty()) trainer.resume(resume);
  Trained run;
  run.result = trainer.run();
  run.ply = read_bytes(run.result.ply);
  run.checkpoint = timeless_bytes(run.result.checkpoint);
  return run;
}

/// Stops a training at each of `stops` and resumes it up to config.iterations, in folders below `folder`. Files must
/// equal those of `whole`, which was never interrupted, byte for byte.
inline void expect_exact_resume(const TrainConfig& config, const Scene& scene, const Trained& whole,
                                const std::filesystem::path& folder, std::initializer_list<int> stops) {
  for (const int stop : stops) {
    SCOPED_TRACE(testing::Message() << "stopped at " << stop);
    const std::filesystem::path own = folder / ("stop" + std::to_string(stop));
    TrainConfig stopped = config;
    stopped.iterations = stop;
    const Trained first = train(stopped, scene, own);
    const Trained second = train(config, scene, own, first.result.checkpoint);
    EXPECT_EQ(second.result.iteration, config.iterations);
    EXPECT_TRUE(same(second.ply, whole.ply)) << "PLY";
    EXPECT_TRUE(same(second.checkpoint, whole.checkpoint)) << "checkpoint";
  }
}

/// Trains, and trains again from each of config.checkpoint_iterations. The results must equal those of the
/// uninterrupted training, byte for byte. Returns that training.
inline Trained expect_exact_resume_from_checkpoints(const TrainConfig& config, const Scene& scene,
                                                    const std::filesystem::path& folder) {
  const Trained whole = train(config, scene, folder / "whole");
  EXPECT_EQ(whole.result.iteration, config.iterations);
  const std::vector<int> saved = ModelFolder(folder / "whole").checkpoint_iterations();
  EXPECT_GE(saved.size(), 5u);
  for (const int iteration : saved) {
    if (iteration == config.iterations) continue;
    EXPECT_EQ(iteration % config.batch, 0) << "checkpoints are between steps";
    const std::filesystem::path own = folder / ("from" + std::to_string(iteration));
    std::filesystem::create_directories(own);
    const std::filesystem::path copy = own / "start.b3dgs";
    std::filesystem::copy_file(ModelFolder(folder / "whole").checkpoint(iteration), copy);
    const Trained resumed = train(config, scene, own / "model", copy);
    EXPECT_TRUE(same(resumed.ply, whole.ply)) << "from " << iteration;
    EXPECT_TRUE(same(resumed.checkpoint, whole.checkpoint)) << "from " << iteration;
  }
  return whole;
}

}  // namespace b3dgs::test
