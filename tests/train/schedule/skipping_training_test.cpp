// Trainings with --skip_share.
#include <gtest/gtest.h>

#include <cmath>

#include "config/view_skips.h"
#include "support/files.h"
#include "support/temp_dir.h"
#include "support/train/disk_scene.h"
#include "support/train/tiny_scene.h"
#include "support/train/training.h"
#include "train/checkpoint/checkpoint.h"

namespace b3dgs {
namespace {

namespace fs = std::filesystem;

using test::train;
using test::Trained;

/// Density control until 15; steps may be skipped from iteration 9 on, except those whose views it counts.
TrainConfig skipping_config() {
  TrainConfig config = test::eventful_config();
  config.iterations = 70;
  config.densify_until_iter = 16;
  config.skip_share = 0.4;
  config.skip_from_iter = 8;
  return config;
}

nlohmann::ordered_json header_of(const fs::path& checkpoint) {
  return read_checkpoint_header(checkpoint);
}

std::int64_t n_skipped(const fs::path& checkpoint) {
  return header_of(checkpoint).at("view_skips").at("n_skipped").get<std::int64_t>();
}

/// A scene of `n_views` views.
Scene scene_of(int n_views) {
  test::TinySceneOptions options;
  options.n_views = n_views;
  return test::make_tiny_scene(options);
}

TEST(SkippingTraining, TakesFewerStepsAndNoMoreThanTheShareLess) {
  const Scene scene = test::make_tiny_scene();
  const test::TempDir temp;
  const TrainConfig config = skipping_config();
  const Trained run = train(config, scene, temp / "model");
  const auto header = header_of(run.result.checkpoint);
  const std::int64_t skipped = n_skipped(run.result.checkpoint);
  EXPECT_GE(skipped, 8);
  EXPECT_LE(static_cast<double>(skipped), 0.4 * (config.iterations - config.skip_from_iter));
  EXPECT_EQ(header.at("adam_steps"), config.iterations - skipped);
  EXPECT_EQ(header.at("iteration"), config.iterations);
  EXPECT_EQ(header.at("sh_degree"), 1) << "schedules go on in skipped steps";
  const std::string log = test::read_bytes(temp / "model" / "train.jsonl");
  EXPECT_NE(log.find("\"skipped\":" + std::to_string(skipped) + ","), std::string::npos) << log;
}

TEST(SkippingTraining, ResumedEqualsUninterruptedBitForBitOnAnyNumberOfThreads) {
  const test::TempDir temp;
  for (const char* strategy : {"default", "mcmc", "balanced"}) {
    for (const int n_views : {2, 3, 8}) {  // one, two and six of them for training
      if (n_views != 8 && strategy != std::string("default")) continue;
      SCOPED_TRACE(testing::Message() << strategy << ", " << n_views << " views");
      const Scene scene = scene_of(n_views);
      const fs::path folder = temp / (strategy + std::to_string(n_views));
      TrainConfig config = std::string(strategy) == "balanced" ? test::eventful_balanced_config() : skipping_config();
      config.strategy = strategy;
      config.max_gaussians = 200;
      config.iterations = 48;
      config.skip_share = 0.4;
      config.skip_from_iter = 8;
      config.antialiasing = config.pose_opt = n_views == 8;
      config.pose_opt_from_iter = 5;
      const Trained whole = train(config, scene, folder / "whole");
      EXPECT_GE(n_skipped(whole.result.checkpoint), 3);
      test::expect_exact_resume(config, scene, whole, folder, {5, 14, 27, 40});
      for (const int threads : {1, 3}) {
        config.threads = threads;
        EXPECT_TRUE(train(config, scene, folder / "again").ply == whole.ply) << threads << " threads";
      }
    }
  }
}

TEST(SkippingTraining, GivesTheSameBytesFromPhotographsThatAreReadAhead) {
  const test::DiskScene disk;
  const test::TempDir temp;
  const TrainConfig config = skipping_config();
  const Trained whole = train(config, disk.load(), temp / "whole");
  EXPECT_GE(n_skipped(whole.result.checkpoint), 8);
  for (const double photographs : {0.0, 2.0, 4.0}) {
    EXPECT_TRUE(train(config, disk.load(photographs), temp / "part").ply == whole.ply) << photographs;
  }
}

TEST(SkippingTraining, StepsThatDensityControlCountsAreTaken) {
  const Scene scene = test::make_tiny_scene();
  const test::TempDir temp;
  TrainConfig config = skipping_config();
  config.densify_until_iter = 71;  // all steps are counted
  EXPECT_EQ(n_skipped(train(config, scene, temp / "default").result.checkpoint), 0);
  config.strategy = "mcmc";  // counts none
  config.max_gaussians = 160;
  EXPECT_GT(n_skipped(train(config, scene, temp / "mcmc").result.checkpoint), 0);
}

TEST(SkippingTraining, IsOffByDefaultAndLeavesNothingInCheckpoints) {
  const Scene scene = test::make_tiny_scene();
  const test::TempDir temp;
  TrainConfig config = skipping_config();
  config.skip_share = 0;
  const Trained off = train(config, scene, temp / "off");
  EXPECT_FALSE(header_of(off.result.checkpoint).contains("view_skips"));
  EXPECT_EQ(test::read_bytes(temp / "off" / "train.jsonl").find("skipped"), std::string::npos);
  // A training that is resumed without the option forgets the losses.
  config.skip_share = 0.4;
  config.iterations = 40;
  const Trained first = train(config, scene, temp / "on");
  ASSERT_TRUE(header_of(first.result.checkpoint).contains("view_skips"));
  config.skip_share = 0;
  config.iterations = 42;
  const Trained second = train(config, scene, temp / "on", first.result.checkpoint);
  EXPECT_FALSE(header_of(second.result.checkpoint).contains("view_skips"));
}

TEST(SkippingTraining, ReadsCheckpointsFromBeforeTheOption) {
  const Scene scene = test::make_tiny_scene();
  const test::TempDir temp;
  TrainConfig config = test::eventful_config();
  config.iterations = 6;
  const fs::path checkpoint = train(config, scene, temp / "model").result.checkpoint;
  CheckpointFile file = read_checkpoint_file(checkpoint);
  for (const char* key : {"skip_share", "skip_from_iter"}) ASSERT_EQ(file.header["config"].erase(key), 1u) << key;
  write_checkpoint_file(temp / "old.ckpt", file);
  config.iterations = 12;
  const Trained expected = train(config, scene, temp / "a", checkpoint);
  EXPECT_TRUE(train(config, scene, temp / "b", temp / "old.ckpt").ply == expected.ply);
}

TEST(SkippingTraining, CheckpointsWithInvalidLossesAreRefused) {
  const Scene scene = test::make_tiny_scene();
  const test::TempDir temp;
  TrainConfig config = skipping_config();
  config.iterations = 30;
  const fs::path checkpoint = train(config, scene, temp / "model").result.checkpoint;
  const CheckpointFile file = read_checkpoint_file(checkpoint);
  const auto reason_for = [&](const std::function<void(nlohmann::ordered_json&)>& change) -> std::string {
    CheckpointFile changed = file;
    change(changed.header["view_skips"]);
    write_checkpoint_file(temp / "changed.ckpt", changed);
    try {
      read_checkpoint(temp / "changed.ckpt", scene, torch::kCPU);
    } catch (const InputError& error) {
      return error.what();
    }
    return "";
  };
  const auto expect_reason = [&](const std::function<void(nlohmann::ordered_json&)>& change, const char* part) {
    const std::string reason = reason_for(change);
    EXPECT_NE(reason.find(part), std::string::npos) << reason;
  };
  EXPECT_EQ(reason_for([](auto&) {}), "");
  expect_reason([](auto& skips) { skips["n_skipped"] = -1; }, "view_skips.n_skipped");
  expect_reason([](auto& skips) { skips.erase("low"); }, "low");
  expect_reason([](auto& skips) { skips["low"] = {6}; }, "expected views below 6 in view_skips.low, found view 6");
  expect_reason([](auto& skips) { skips["mean_losses"].erase(0); }, "expected 6 losses in view_skips.mean_losses");
  expect_reason([](auto& skips) { skips["mean_losses"][0] = -0.5; }, "expected at least 0, found -0.5");
  expect_reason([](auto& skips) { skips["mean_losses"][0] = "low"; }, "must be a finite number");
  expect_reason([](auto& skips) { skips = 3; }, "unexpected checkpoint header");
}

TEST(SkippingTraining, LosesLessOfTheProgressThanItSkips) {
  test::TinySceneOptions options;
  options.n_gaussians = 60;
  options.n_views = 24;
  const Scene scene = test::make_tiny_scene(options);
  const test::TempDir temp;
  TrainConfig config;
  config.iterations = config.position_lr_max_steps = 700;
  config.densify_from_iter = 50;
  config.densify_until_iter = 200;
  config.test_iterations = {300};
  config.kernel = "shared-memory";
  config.skip_from_iter = 300;
  const auto progress_since_300 = [&](double share, const char* name) {
    config.skip_share = share;
    const TrainResult result = Trainer(config, scene, ModelFolder(temp / name), {}).run();
    if (share > 0) {
      EXPECT_GE(n_skipped(result.checkpoint), 110) << "of 400, a share of 0.3 would be 120";
    }
    return result.evaluations.back().second.mean.psnr - result.evaluations.front().second.mean.psnr;
  };
  const double whole = progress_since_300(0, "whole"), skipping = progress_since_300(0.3, "skipping");
  EXPECT_GT(whole, 0.5);
  EXPECT_GT(skipping, 0.7 * whole) << whole;
}

}  // namespace
}  // namespace b3dgs
