// Tests trainings with --batch.
#include <gtest/gtest.h>

#include <atomic>
#include <cmath>

#include "support/approx.h"
#include "support/files.h"
#include "support/same.h"
#include "support/temp_dir.h"
#include "support/train/tiny_scene.h"
#include "support/train/training.h"
#include "train/checkpoint/checkpoint.h"

namespace b3dgs {
namespace {

namespace fs = std::filesystem;
using test::train;
using test::Trained;

/// Returns a config with steps of 3 views, the last one of 2. Density control falls within steps.
TrainConfig batched_config() {
  TrainConfig config = test::eventful_config();
  config.iterations = 23;
  config.batch = 3;
  return config;
}

TEST(BatchTraining, StopsBetweenSteps) {
  const Scene scene = test::make_tiny_scene();
  const test::TempDir temp;
  const TrainConfig config = batched_config();
  const Trained whole = train(config, scene, temp / "whole");
  std::atomic<int> signal{0};
  TrainHooks hooks;
  hooks.stop_signal = &signal;
  hooks.on_progress = [&](const TrainProgress& progress) {
    if (progress.iteration >= 10) signal = 2;
  };
  const fs::path folder = temp / "stopped";
  Trainer trainer(finalize(config, scene), scene, ModelFolder(folder), hooks);
  const TrainResult stopped = trainer.run();
  EXPECT_TRUE(stopped.interrupted);
  EXPECT_EQ(stopped.iteration, 12);
  EXPECT_TRUE(test::same(train(config, scene, folder, stopped.checkpoint).checkpoint, whole.checkpoint));
}

TEST(BatchTraining, StepsAlongTheSameViewTwiceHaveItsGradient) {
  test::TinySceneOptions options;
  options.n_views = 2;  // one of them for training
  const Scene scene = test::make_tiny_scene(options);
  ASSERT_EQ(scene.train.size(), 1u);
  const test::TempDir temp;
  TrainConfig config;
  config.test_iterations = config.save_iterations = {};
  config.kernel = "sub-tile";
  config.iterations = 1;
  const auto moments = [&](const char* name) {
    const fs::path checkpoint = train(config, scene, temp / name).result.checkpoint;
    return read_checkpoint(checkpoint, scene, torch::kCPU).state;
  };
  const TrainState once = moments("once");
  config.iterations = config.batch = 2;
  const TrainState twice = moments("twice");
  EXPECT_EQ(twice.adam.steps, 2);
  for (std::size_t i = 0; i < 5; ++i) {
    const torch::Tensor gradient = *once.adam.m.all()[i] / 0.1, found = *twice.adam.m.all()[i] / (1 - 0.81);
    EXPECT_GT(gradient.abs().max().item<float>(), 0) << GaussianTensors::kNames[i];
    EXPECT_TRUE(test::within(found, gradient, 2e-6 * gradient.abs().max().item<double>()))
        << GaussianTensors::kNames[i];
  }
  // With bias correction, the first step has the size of the rate, so it is sqrt(2) times as large with two views.
  const torch::Tensor before = torch::logit(torch::full({1}, 0.1)), one = once.gaussians.logit_opacities - before,
                      two = twice.gaussians.logit_opacities - before;
  const torch::Tensor moved = one.abs() > 0.02;
  ASSERT_GT(moved.sum().item<int>(), 50);
  EXPECT_TRUE(test::within(two.index({moved}), std::sqrt(2) * one.index({moved}), 1e-4));
  EXPECT_EQ(twice.statistics.view_count.max().item<int>(), 2) << "statistics are added per view";
  EXPECT_TRUE(test::within(twice.statistics.grad_norm_sum, 2 * once.statistics.grad_norm_sum,
                           1e-5 * once.statistics.grad_norm_sum.abs().max().item<double>()));
}

TEST(BatchTraining, LearnsAsMuchAsWithOneViewAStep) {
  const Scene scene = test::make_tiny_scene();
  const test::TempDir temp;
  const auto psnr = [&](int batch) {
    TrainConfig config;
    config.seed = 3;
    config.sh_degree = 0;
    config.kernel = "sub-tile";
    config.iterations = 150;
    config.position_lr_max_steps = 150;
    config.densify_until_iter = 0;
    config.save_iterations = {};
    config.test_iterations = {150};
    config.batch = batch;
    return train(config, scene, temp / std::to_string(batch)).result.evaluations.back().second.mean.psnr;
  };
  const double one = psnr(1);
  EXPECT_GT(one, 15);
  EXPECT_GT(psnr(2), one - 1);
  EXPECT_GT(psnr(4), one - 1);
}

TEST(BatchTraining, RollsBackAStepWhoseSecondViewFails) {
  // The Gaussian is invalid in one view only, where it is close to the near plane and its projection is too large.
  const Scene scene = test::make_tiny_scene();
  const test::TempDir temp;
  TrainConfig config = batched_config();
  config.iterations = 6;
  const Trained first = train(config, scene, temp / "model");
  Checkpoint read = read_checkpoint(first.result.checkpoint, scene, torch::kCPU);
  // Finds the second of the next three views.
  ViewOrder order = read.state.view_order;
  order.next(config.seed, static_cast<std::int32_t>(scene.train.size()));
  const auto second = static_cast<std::size_t>(order.next(config.seed, static_cast<std::int32_t>(scene.train.size())));
  const PinholeView view = to_camera_view(scene.train[second].camera);
  // The Gaussian is 0.3 in front of its camera, and 1e9 px large there. It is behind the other cameras, or too far away
  // to be as large.
  const Vec3f forward{view.rotation(2, 0), view.rotation(2, 1), view.rotation(2, 2)};
  read.state.gaussians.means[7] = torch::tensor(
      {view.center.x + 0.3f * forward.x, view.center.y + 0.3f * forward.y, view.center.z + 0.3f * forward.z});
  read.state.gaussians.log_scales[7] = std::log(6e6f);
  read.state.gaussians.logit_opacities[7] = 2;
  const std::int64_t before = read.state.gaussians.size();
  write_checkpoint(first.result.checkpoint, read.config, read.state, scene);
  config.iterations = 12;
  config.densify_until_iter = 0;
  std::vector<std::string> warnings;
  TrainHooks hooks;
  hooks.on_warning = [&](const std::string& message) { warnings.push_back(message); };
  const Trained bad = train(config, scene, temp / "model", first.result.checkpoint, hooks);
  EXPECT_EQ(bad.result.n_removed, 1);
  EXPECT_EQ(bad.result.n_gaussians, before - 1);
  ASSERT_FALSE(warnings.empty());
  EXPECT_NE(warnings[0].find("after iteration 6: removed 1 Gaussian"), std::string::npos) << warnings[0];
  // Trains without that Gaussian from the start.
  const auto without = [](torch::Tensor& rows) {
    rows = torch::cat({rows.slice(0, 0, 7), rows.slice(0, 8)}).contiguous();
  };
  for (GaussianTensors* group : {&read.state.gaussians, &read.state.adam.m, &read.state.adam.v}) {
    for (torch::Tensor* tensor : group->all()) without(*tensor);
  }
  for (torch::Tensor* column : read.state.statistics.all()) without(*column);
  fs::create_directories(temp / "other");
  const fs::path start = temp / "other" / "start.b3dgs";
  write_checkpoint(start, read.config, read.state, scene);
  EXPECT_TRUE(test::same(train(config, scene, temp / "good", start).ply, bad.ply));
}

TEST(BatchTraining, SaysTheRuleAtTheStart) {
  const Scene scene = test::make_tiny_scene();
  const test::TempDir temp;
  std::vector<std::string> messages;
  TrainHooks hooks;
  hooks.on_message = [&](const std::string& message) { messages.push_back(message); };
  TrainConfig config = batched_config();
  config.batch = 4;
  config.iterations = 4;
  train(config, scene, temp / "batch", {}, hooks);
  ASSERT_FALSE(messages.empty());
  EXPECT_EQ(messages[0],
            "steps of 4 views: mean gradient, learning rates x 2, Adam's epsilon / 2, betas to the power of 4");
}

}  // namespace
}  // namespace b3dgs
