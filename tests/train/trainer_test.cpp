#include "train/trainer.h"

#include <gtest/gtest.h>

#include <fstream>
#include <nlohmann/json.hpp>

#include "check.h"
#include "parallel.h"
#include "scene/ply.h"
#include "support/expect_error.h"
#include "support/files.h"
#include "support/temp_dir.h"
#include "train/checkpoint.h"
#include "train/checkpoint_file.h"
#include "train/densifier.h"
#include "train/threads.h"
#include "train/tiny_scene.h"

namespace b3dgs {
namespace {

namespace fs = std::filesystem;

/// Density control at 10, 15, 20, ... with clones, splits and prunes, opacity resets at 12 and 24, SH degree up at 7.
TrainConfig eventful_config() {
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
  return config;
}

struct Trained {
  TrainResult result;
  std::string ply, checkpoint;  // bytes
};

Trained train(const TrainConfig& config, const Scene& scene, const fs::path& folder, const fs::path& resume = {}) {
  Trainer trainer(config, scene, ModelFolder(folder), {});
  if (!resume.empty()) trainer.resume(resume);
  Trained run;
  run.result = trainer.run();
  run.ply = test::read_bytes(run.result.ply);
  run.checkpoint = test::read_bytes(run.result.checkpoint);
  return run;
}

TEST(Trainer, ResumedEqualsUninterruptedBitForBit) {
  const Scene scene = test::make_tiny_scene();
  const test::TempDir temp;
  TrainConfig config = eventful_config();
  ASSERT_TRUE(density_plan(config, 10).densify && density_plan(config, 12).reset_opacities);
  const Trained whole = train(config, scene, temp / "whole");
  EXPECT_GT(whole.result.n_gaussians, 150) << "no density control happened";
  for (const int stop :
       {3, 10, 12, 19}) {  // before all, at a round of density control, at an opacity reset, at the end
    const fs::path folder = temp / ("stop" + std::to_string(stop));
    config.iterations = stop;
    const Trained first = train(config, scene, folder);
    config.iterations = 20;
    const Trained second = train(config, scene, folder, first.result.checkpoint);
    EXPECT_EQ(second.result.iteration, 20);
    EXPECT_TRUE(second.ply == whole.ply) << "stopped at " << stop;
    EXPECT_TRUE(second.checkpoint == whole.checkpoint) << "stopped at " << stop;
  }
}

TEST(Trainer, RunInPiecesEqualsOneRunBitForBit) {
  const Scene scene = test::make_tiny_scene();
  const test::TempDir temp;
  TrainConfig config = eventful_config();
  config.save_iterations = config.checkpoint_iterations = config.test_iterations = {8};
  config.densify_until_iter = config.iterations;  // the last evaluation is of the model as it stays
  const Trained whole = train(config, scene, temp / "whole");
  // Two trainers that take turns, as a comparison has them.
  const ModelFolder folders[] = {ModelFolder(temp / "a"), ModelFolder(temp / "b")};
  Trainer a(config, scene, folders[0], {}), b(config, scene, folders[1], {});
  for (const int until : {0, 1, 8, 8, 10, 17, 20}) {
    for (Trainer* trainer : {&a, &b}) {
      const TrainResult result = trainer->run_until(until);
      EXPECT_EQ(result.iteration, until);
      EXPECT_EQ(trainer->iteration(), until);
    }
  }
  for (const ModelFolder& folder : folders) {
    EXPECT_TRUE(test::read_bytes(folder.ply(20)) == whole.ply);
    EXPECT_TRUE(test::read_bytes(folder.checkpoint(20)) == whole.checkpoint);
    EXPECT_EQ(folder.ply_iterations(), (std::vector<int>{8, 20}));
    EXPECT_EQ(folder.checkpoint_iterations(), (std::vector<int>{8, 20}));
  }
  const TrainResult result = a.run_until(20);
  ASSERT_EQ(result.evaluations.size(), 2u);
  EXPECT_EQ(a.evaluate(scene.test).mean.psnr, result.evaluations.back().second.mean.psnr);
  EXPECT_THROW(a.run_until(21), LogicError);
}

TEST(Trainer, APausedRunContinuesFromTheCheckpointItIsToldToWrite) {
  const Scene scene = test::make_tiny_scene();
  const test::TempDir temp;
  const TrainConfig config = eventful_config();
  const ModelFolder folder(temp / "paused");
  fs::path checkpoint;
  {
    Trainer trainer(config, scene, folder, {});
    EXPECT_THROW(trainer.write_checkpoint(), LogicError) << "there is nothing yet";
    trainer.run_until(11);
    checkpoint = trainer.write_checkpoint();
  }
  EXPECT_EQ(checkpoint, folder.checkpoint(11));
  EXPECT_TRUE(train(config, scene, folder.root(), checkpoint).ply == train(config, scene, temp / "whole").ply);
}

TEST(Trainer, TwoRunsGiveTheSameBytesOnAnyNumberOfThreads) {
  const Scene scene = test::make_tiny_scene();
  const test::TempDir temp;
  TrainConfig config = eventful_config();
  const Trained first = train(config, scene, temp / "a");
  for (const int threads : {0, 1, 3}) {
    config.threads = threads;
    EXPECT_TRUE(train(config, scene, temp / "b").ply == first.ply) << threads << " threads";
  }
  config.threads = 0;
  config.seed = 10;
  EXPECT_FALSE(train(config, scene, temp / "c").ply == first.ply) << "the seed changes nothing";
}

TEST(Trainer, StopsOnASignalWithACheckpointToContinueFrom) {
  const Scene scene = test::make_tiny_scene();
  const test::TempDir temp;
  const TrainConfig config = eventful_config();
  std::atomic<int> signal{0};
  TrainHooks hooks;
  hooks.stop_signal = &signal;
  hooks.on_progress = [&](const TrainProgress& progress) { signal = progress.iteration == 13 ? 15 : 0; };
  const TrainResult stopped = Trainer(config, scene, ModelFolder(temp / "stopped"), hooks).run();
  EXPECT_TRUE(stopped.interrupted);
  EXPECT_EQ(stopped.iteration, 13);
  EXPECT_EQ(stopped.checkpoint, ModelFolder(temp / "stopped").checkpoint(13));
  EXPECT_TRUE(stopped.ply.empty());
  const Trained whole = train(config, scene, temp / "whole");
  EXPECT_TRUE(train(config, scene, temp / "stopped", stopped.checkpoint).ply == whole.ply);
}

TEST(Trainer, ComputesOnAsManyThreadsAsAskedFor) {
  const Scene scene = test::make_tiny_scene();
  const test::TempDir temp;
  TrainConfig config = eventful_config();
  for (const int threads : {3, 1, 2}) {
    config.threads = threads;
    train(config, scene, temp.path());
    EXPECT_EQ(thread_count(), threads) << "LibTorch has taken over";
  }
  set_compute_threads(0);
}

/// PSNR on held-out views before and after 800 iterations.
std::pair<double, double> learn(bool masked) {
  test::TinySceneOptions options;
  options.n_gaussians = 60;
  options.n_views = 24;
  options.masked = masked;
  const Scene scene = test::make_tiny_scene(options);
  const test::TempDir temp;
  TrainConfig config;
  config.iterations = 800;
  config.densify_from_iter = 100;
  config.test_iterations = {1};
  const TrainResult result = Trainer(config, scene, ModelFolder(temp.path()), {}).run();
  EXPECT_EQ(result.evaluations.size(), 2u);
  return {result.evaluations.front().second.mean.psnr, result.evaluations.back().second.mean.psnr};
}

TEST(Trainer, LearnsAScene) {
  const auto [before, after] = learn(false);
  EXPECT_LT(before, 20);
  EXPECT_GT(after, 31);
}

TEST(Trainer, IsNotLedAstrayByPixelsThatAreNotValid) {
  // They are white: a model that had to explain them would be white there in the other views too.
  EXPECT_GT(learn(true).second, 29);
}

TEST(Trainer, NeverGrowsBeyondTheLimit) {
  const Scene scene = test::make_tiny_scene();
  const test::TempDir temp;
  TrainConfig config = eventful_config();
  config.max_gaussians = 130;
  std::int64_t most = 0;
  TrainHooks hooks;
  hooks.on_progress = [&](const TrainProgress& progress) { most = std::max(most, progress.n_gaussians); };
  Trainer(config, scene, ModelFolder(temp.path()), hooks).run();
  EXPECT_GT(most, 120);
  EXPECT_LE(most, 130);
}

TEST(Trainer, NamesIterationViewAndCheckpointIfTheLossIsNotFinite) {
  Scene scene = test::make_tiny_scene();
  const test::TempDir temp;
  SplatCloud cloud = splats_from_points(scene.points, 0);
  std::fill(cloud.sh0.begin(), cloud.sh0.end(), 3e38f);  // finite, but not its square
  write_splat_ply(temp / "bright.ply", cloud);
  TrainConfig config = eventful_config();
  config.init_ply = (temp / "bright.ply").string();
  EXPECT_TRUE(test::fails_with<NumericError>({"iteration 1, view view", "checkpoint: none"},
                                             [&] { train(config, scene, temp / "model"); }));

  // The same after a checkpoint, by a rate that overshoots.
  config.init_ply = "";
  config.iterations = 4;
  const Trained run = train(config, scene, temp / "model");
  config.iterations = 10;
  config.feature_lr = 1e38;
  EXPECT_TRUE(test::fails_with<NumericError>({"view view", run.result.checkpoint.string()},
                                             [&] { train(config, scene, temp / "model", run.result.checkpoint); }));
}

TEST(Trainer, NeedsPointsOrAPly) {
  Scene scene = test::make_tiny_scene();
  const test::TempDir temp;
  write_splat_ply(temp / "splats.ply", splats_from_points(scene.points, 2));
  write_point_ply(temp / "points.ply", scene.points);
  scene.points = {};
  TrainConfig config = eventful_config();
  config.iterations = 2;
  EXPECT_TRUE(test::fails_with<InputError>({"tiny", "no 3D points", "--init_ply"},
                                           [&] { train(config, scene, temp / "none"); }));
  config.init_ply = (temp / "splats.ply").string();
  EXPECT_EQ(train(config, scene, temp / "a").result.n_gaussians, 120);
  EXPECT_EQ(read_checkpoint_header(ModelFolder(temp / "a").checkpoint(2))["sh_degree"], 1) << "that of the PLY, capped";
  config.init_ply = (temp / "points.ply").string();
  EXPECT_EQ(train(config, scene, temp / "b").result.n_gaussians, 120);
}

TEST(Trainer, RefusesWhatItCannotResume) {
  const Scene scene = test::make_tiny_scene();
  const test::TempDir temp;
  TrainConfig config = eventful_config();
  config.iterations = 6;
  const fs::path checkpoint = train(config, scene, temp / "model").result.checkpoint;
  config.iterations = 5;
  EXPECT_TRUE(test::fails_with<InputError>({"iteration 6", "--iterations 5"}, [&] {
    Trainer(config, scene, ModelFolder(temp / "model"), {}).resume(checkpoint);
  }));
  config.iterations = 8;
  config.sh_degree = 2;
  EXPECT_TRUE(test::fails_with<InputError>(
      {"SH degree 1"}, [&] { Trainer(config, scene, ModelFolder(temp / "model"), {}).resume(checkpoint); }));
  config.sh_degree = 1;
  config.opacity_lr = 0.05;
  EXPECT_EQ(Trainer(config, scene, ModelFolder(temp / "model"), {}).resume(checkpoint),
            (std::vector<std::string>{"iterations: 6 -> 8", "opacity_lr: 0.025 -> 0.05"}));
}

TEST(Trainer, LogsEveryTenthIterationAndGoesBackOnResume) {
  const Scene scene = test::make_tiny_scene();
  const test::TempDir temp;
  TrainConfig config = eventful_config();
  config.iterations = 35;
  config.checkpoint_iterations = {15};
  config.test_iterations = {13};
  train(config, scene, temp.path());
  const auto iterations = [&] {
    std::vector<int> list;
    std::ifstream file(temp / "train.jsonl");
    for (std::string line; std::getline(file, line);) {
      const nlohmann::json json = nlohmann::json::parse(line);
      EXPECT_TRUE(json["loss"].is_number() && json["ms"].is_number() && json["count"].is_number_integer());
      EXPECT_EQ(json.contains("test_psnr"), json["iteration"] == 13 || json["iteration"] == config.iterations);
      list.push_back(json["iteration"]);
    }
    return list;
  };
  EXPECT_EQ(iterations(), (std::vector<int>{10, 13, 20, 30, 35}));
  std::ofstream(temp / "train.jsonl", std::ios::app) << "{\"iteration\": 3";  // as a crash leaves it
  config.iterations = 20;
  train(config, scene, temp.path(), ModelFolder(temp.path()).checkpoint(15));
  EXPECT_EQ(iterations(), (std::vector<int>{10, 13, 20}));
}

TEST(Trainer, KeepsTheNewestCheckpoints) {
  const Scene scene = test::make_tiny_scene();
  const test::TempDir temp;
  TrainConfig config = eventful_config();
  config.checkpoint_interval = 4;
  config.checkpoint_iterations = {7};
  config.keep_checkpoints = 3;
  config.iterations = 18;
  train(config, scene, temp.path());
  EXPECT_EQ(ModelFolder(temp.path()).checkpoint_iterations(), (std::vector<int>{12, 16, 18}));
}

TEST(Trainer, HasNothingToDoAtTheEnd) {
  const Scene scene = test::make_tiny_scene();
  const test::TempDir temp;
  TrainConfig config = eventful_config();
  config.iterations = 3;
  const Trained run = train(config, scene, temp.path());
  const Trained again = train(config, scene, temp.path(), run.result.checkpoint);
  EXPECT_EQ(again.result.iteration, 3);
  EXPECT_FALSE(again.result.interrupted);
  EXPECT_TRUE(again.ply == run.ply);
}

}  // namespace
}  // namespace b3dgs
