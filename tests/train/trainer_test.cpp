#include "train/trainer.h"

#include <gtest/gtest.h>

#include <fstream>
#include <nlohmann/json.hpp>

#include "config/train_options.h"
#include "core/check.h"
#include "core/parallel.h"
#include "model/formats/splat_formats.h"
#include "support/expect_error.h"
#include "support/same.h"
#include "support/temp_dir.h"
#include "support/train/tiny_scene.h"
#include "support/train/training.h"
#include "train/checkpoint/checkpoint.h"
#include "train/density/strategies/strategies.h"
#include "train/device.h"

namespace b3dgs {
namespace {

namespace fs = std::filesystem;

using test::eventful_config;
using test::train;
using test::Trained;

TEST(Trainer, TellsTheSizeOfTheSavedModel) {
  const Scene scene = test::make_tiny_scene();
  const test::TempDir temp;
  TrainConfig config = eventful_config();
  config.iterations = 10;
  ASSERT_TRUE(make_density_strategy(config, 1)->plan(config.iterations).densify)
      << "the PLY is written before this round";
  const TrainResult result = train(config, scene, temp / "model").result;
  EXPECT_EQ(result.n_saved, read_splat_ply(result.ply).size());
  EXPECT_NE(result.n_gaussians, result.n_saved);
}

TEST(Trainer, ResumedEqualsUninterruptedBitForBit) {
  const Scene scene = test::make_tiny_scene();
  const test::TempDir temp;
  TrainConfig config = eventful_config();
  const std::unique_ptr<DensityStrategy> strategy = make_density_strategy(config, 1);
  ASSERT_TRUE(strategy->plan(10).densify && strategy->plan(12).lower_opacities);
  const Trained whole = train(config, scene, temp / "whole");
  EXPECT_GT(whole.result.n_gaussians, 150) << "no density control happened";
  // Resumes from the start, at a round of density control, at an opacity reset, and near the end.
  test::expect_exact_resume(config, scene, whole, temp.path(), {3, 10, 12, 19});
}

TEST(Trainer, RunInPiecesEqualsOneRunBitForBit) {
  const Scene scene = test::make_tiny_scene();
  const test::TempDir temp;
  TrainConfig config = eventful_config();
  config.save_iterations = config.checkpoint_iterations = config.test_iterations = {8};
  config.densify_until_iter = config.iterations;  // the last evaluation shows the final model
  const Trained whole = train(config, scene, temp / "whole");
  // Two trainers that take turns, as in b3dgs compare.
  const ModelFolder folders[] = {ModelFolder(temp / "a"), ModelFolder(temp / "b")};
  Trainer a(finalize(config, scene), scene, folders[0], {}), b(finalize(config, scene), scene, folders[1], {});
  for (const int until : {0, 1, 8, 8, 10, 17, 20}) {
    for (Trainer* trainer : {&a, &b}) {
      const TrainResult result = trainer->run(until);
      EXPECT_EQ(result.iteration, until);
      EXPECT_EQ(trainer->iteration(), until);
    }
  }
  for (const ModelFolder& folder : folders) {
    EXPECT_TRUE(test::same(test::read_bytes(folder.ply(20)), whole.ply));
    EXPECT_TRUE(test::same(test::timeless_bytes(folder.checkpoint(20)), whole.checkpoint));
    EXPECT_EQ(folder.ply_iterations(), (std::vector<int>{8, 20}));
    EXPECT_EQ(folder.checkpoint_iterations(), (std::vector<int>{8, 20}));
  }
  const TrainResult result = a.run(20);
  ASSERT_EQ(result.evaluations.size(), 2u);
  EXPECT_EQ(a.evaluate(scene.test).mean.psnr, result.evaluations.back().second.mean.psnr);
  EXPECT_THROW(a.run(21), LogicError);
}

TEST(Trainer, ResumesFromACheckpointWrittenOnRequest) {
  const Scene scene = test::make_tiny_scene();
  const test::TempDir temp;
  const TrainConfig config = eventful_config();
  const ModelFolder folder(temp / "paused");
  fs::path checkpoint;
  {
    Trainer trainer(finalize(config, scene), scene, folder, {});
    EXPECT_THROW(trainer.write_checkpoint(), LogicError) << "there is nothing yet";
    trainer.run(11);
    checkpoint = trainer.write_checkpoint();
  }
  EXPECT_EQ(checkpoint, folder.checkpoint(11));
  EXPECT_TRUE(
      test::same(train(config, scene, folder.root(), checkpoint).ply, train(config, scene, temp / "whole").ply));
}

TEST(Trainer, TwoRunsGiveTheSameBytesOnAnyNumberOfThreads) {
  const Scene scene = test::make_tiny_scene();
  const test::TempDir temp;
  TrainConfig config = eventful_config();
  const Trained first = train(config, scene, temp / "a");
  for (const int threads : {0, 1, 3}) {
    config.threads = threads;
    EXPECT_TRUE(test::same(train(config, scene, temp / "b").ply, first.ply)) << threads << " threads";
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
  const TrainResult stopped = Trainer(finalize(config, scene), scene, ModelFolder(temp / "stopped"), hooks).run();
  EXPECT_TRUE(stopped.interrupted);
  EXPECT_EQ(stopped.iteration, 13);
  EXPECT_EQ(stopped.checkpoint, ModelFolder(temp / "stopped").checkpoint(13));
  EXPECT_EQ(stopped.ply, ModelFolder(temp / "stopped").ply(13)) << "for viewers";
  EXPECT_TRUE(std::filesystem::exists(stopped.ply));
  const Trained whole = train(config, scene, temp / "whole");
  EXPECT_TRUE(test::same(train(config, scene, temp / "stopped", stopped.checkpoint).ply, whole.ply));
}

TEST(Trainer, UsesTheRequestedNumberOfThreads) {
  const Scene scene = test::make_tiny_scene();
  const test::TempDir temp;
  TrainConfig config = eventful_config();
  for (const int threads : {3, 1, 2}) {
    config.threads = threads;
    train(config, scene, temp.path());
    EXPECT_EQ(thread_count(), threads) << "LibTorch changed the number of threads";
  }
  set_compute_threads(0);
}

/// Returns the PSNR on held-out views before and after 800 iterations.
std::pair<double, double> learn(bool masked) {
  test::TinySceneOptions options = test::learnable_scene();
  options.masked = masked;
  const Scene scene = test::make_tiny_scene(options);
  const test::TempDir temp;
  TrainConfig config;
  config.iterations = 800;
  config.densify_from_iter = 100;
  config.test_iterations = {1};
  const TrainResult result = Trainer(finalize(config, scene), scene, ModelFolder(temp.path()), {}).run();
  EXPECT_EQ(result.evaluations.size(), 2u);
  return {result.evaluations.front().second.mean.psnr, result.evaluations.back().second.mean.psnr};
}

TEST(Trainer, LearnsAScene) {
  const auto [before, after] = learn(false);
  EXPECT_LT(before, 20);
  EXPECT_GT(after, 31);
}

TEST(Trainer, IgnoresInvalidPixels) {
  // Invalid pixels are white. A model fitted to them would be white there in the other views, too.
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
  Trainer(finalize(config, scene), scene, ModelFolder(temp.path()), hooks).run();
  EXPECT_GT(most, 120);
  EXPECT_LE(most, 130);
}

TEST(Trainer, NamesIterationViewAndCheckpointIfTheLossIsNotFinite) {
  Scene scene = test::make_tiny_scene();
  const test::TempDir temp;
  TrainConfig config = eventful_config();
  config.lambda_dssim = NAN;  // renders are always finite, so only this can make the loss NaN
  EXPECT_TRUE(test::fails_with<NumericError>({"iteration 1, view view", "checkpoint: none"},
                                             [&] { train(config, scene, temp / "model"); }));

  // The same, but after a checkpoint.
  config = eventful_config();
  config.iterations = 4;
  const Trained run = train(config, scene, temp / "model");
  config.iterations = 10;
  config.lambda_dssim = NAN;
  EXPECT_TRUE(test::fails_with<NumericError>({"iteration 5, view view", run.result.checkpoint.string()},
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

TEST(Trainer, AStartThatHasFailedIsNotSkippedTheNextTime) {
  Scene scene = test::make_tiny_scene();
  scene.points = {};
  const test::TempDir temp;
  Trainer trainer(finalize(eventful_config(), scene), scene, ModelFolder(temp / "model"), {});
  for (int i = 0; i < 2; ++i) {
    EXPECT_TRUE(test::fails_with<InputError>({"no 3D points"}, [&] { trainer.run(); })) << i;
  }
}

TEST(Trainer, RejectsCheckpointsThatItCannotResume) {
  const Scene scene = test::make_tiny_scene();
  const test::TempDir temp;
  TrainConfig config = eventful_config();
  config.iterations = 6;
  const fs::path checkpoint = train(config, scene, temp / "model").result.checkpoint;
  config.iterations = 5;
  EXPECT_TRUE(test::fails_with<InputError>({"iteration 6", "--iterations 5"}, [&] {
    Trainer(finalize(config, scene), scene, ModelFolder(temp / "model"), {}).resume(checkpoint);
  }));
  config.iterations = 8;
  config.sh_degree = 2;
  EXPECT_TRUE(test::fails_with<InputError>({"SH degree 1"}, [&] {
    Trainer(finalize(config, scene), scene, ModelFolder(temp / "model"), {}).resume(checkpoint);
  }));
  config.sh_degree = 1;
  config.opacity_lr = 0.05;
  EXPECT_EQ(Trainer(finalize(config, scene), scene, ModelFolder(temp / "model"), {}).resume(checkpoint),
            (std::vector<std::string>{"iterations: 6 -> 8", "opacity_lr: 0.025 -> 0.05"}));
}

TEST(Trainer, LogsEveryTenthIterationAndDropsLaterLinesOnResume) {
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
      if (json.contains("event")) continue;
      EXPECT_TRUE(json["loss"].is_number() && json["ms"].is_number() && json["count"].is_number_integer());
      EXPECT_EQ(json.contains("test_psnr"), json["iteration"] == 13 || json["iteration"] == config.iterations);
      list.push_back(json["iteration"]);
    }
    return list;
  };
  EXPECT_EQ(iterations(), (std::vector<int>{10, 13, 20, 30, 35}));
  std::ofstream(temp / "train.jsonl", std::ios::app) << "{\"iteration\": 3";  // an incomplete line, as after a crash
  config.iterations = 20;
  train(config, scene, temp.path(), ModelFolder(temp.path()).checkpoint(15));
  EXPECT_EQ(iterations(), (std::vector<int>{10, 13, 20}));
}

TEST(Trainer, AddsUpTimeOverAllSessions) {
  const Scene scene = test::make_tiny_scene();
  const test::TempDir temp;
  const auto elapsed_of = [](const fs::path& checkpoint) {
    return read_checkpoint_header(checkpoint)["elapsed_s"].get<double>();
  };
  TrainConfig config = eventful_config();
  config.iterations = 10;
  const Trained first = train(config, scene, temp.path());
  EXPECT_GT(first.result.train_s, 0);
  EXPECT_EQ(elapsed_of(first.result.checkpoint), first.result.train_s);
  config.iterations = 20;
  const double before = elapsed_of(first.result.checkpoint);
  const Trained second = train(config, scene, temp.path(), first.result.checkpoint);
  EXPECT_DOUBLE_EQ(elapsed_of(second.result.checkpoint), before + second.result.train_s);

  std::ifstream file(temp / "train.jsonl");
  double last = 0;
  for (std::string line; std::getline(file, line);) {
    const nlohmann::json json = nlohmann::json::parse(line);
    if (json.contains("event")) continue;
    const double elapsed = json.at("elapsed_s").get<double>();
    EXPECT_GT(elapsed, last) << line;
    last = elapsed;
  }
  EXPECT_GT(last, before);
  EXPECT_LE(last, elapsed_of(second.result.checkpoint));
}

TEST(Trainer, RendersWithTheGivenOptions) {
  TrainConfig config;
  EXPECT_EQ(base_render_settings(config, 2).culling, Culling::kEllipse);
  EXPECT_EQ(base_render_settings(config, 2).kernel, kStandardKernel);
  EXPECT_FALSE(base_render_settings(config, 2).deterministic);
  config_from_json(config, {{"culling", "square"}, {"kernel", "combined"}, {"deterministic", true}}, "test");
  const RenderSettings settings = base_render_settings(config, 2);
  EXPECT_EQ(settings.culling, Culling::kSquare);
  EXPECT_EQ(settings.kernel, ForwardKernel::kCombined);
  EXPECT_TRUE(settings.deterministic);
  EXPECT_EQ(settings.stages, nullptr);
  const auto refused = [&](const nlohmann::ordered_json& json, const std::string& part) {
    return test::fails_with<InputError>({part}, [&] { config_from_json(config, json, "test"); });
  };
  EXPECT_TRUE(refused({{"culling", "round"}}, "invalid value for culling: test (expected one of ellipse, square"));
  EXPECT_TRUE(refused({{"kernel", "per-pixel"}}, "invalid value for kernel: test (expected one of naive, dynamic"));
  EXPECT_TRUE(refused({{"host_memory_gb", -2}}, "invalid value for host_memory_gb: test (expected at least -1"));
}

TEST(Trainer, IsAlwaysDeterministicOnTheCpu) {
  const Scene scene = test::make_tiny_scene();
  const test::TempDir temp;
  TrainConfig config = eventful_config();
  const Trained first = train(config, scene, temp / "first");
  config.deterministic = true;
  config.image_cache_gb = 0;
  EXPECT_TRUE(test::same(train(config, scene, temp / "same").ply, first.ply)) << "these options only affect the GPU";
}

/// Returns the lines of train.jsonl with this event, or without any.
std::vector<nlohmann::json> log_lines(const fs::path& folder, const std::string& event) {
  std::vector<nlohmann::json> lines;
  std::ifstream file(folder / "train.jsonl");
  for (std::string line; std::getline(file, line);) {
    const nlohmann::json json = nlohmann::json::parse(line);
    if (json.value("event", "") == event) lines.push_back(json);
  }
  return lines;
}

std::vector<int> iterations_of(const std::vector<nlohmann::json>& lines) {
  std::vector<int> iterations;
  for (const nlohmann::json& line : lines) iterations.push_back(line.at("iteration"));
  return iterations;
}

TEST(Trainer, LogsHowUnevenTheLoadIs) {
  const Scene scene = test::make_tiny_scene();
  const test::TempDir temp;
  TrainConfig config = eventful_config();
  config.stats_interval = 7;
  train(config, scene, temp.path());
  const std::vector<nlohmann::json> lines = log_lines(temp.path(), "load_statistics");
  EXPECT_EQ(iterations_of(lines), (std::vector<int>{1, 7, 14}));
  for (const nlohmann::json& line : lines) {
    EXPECT_EQ(line.at("views"), 4);
    for (const char* what : {"tile_lists", "pixel_processed", "pixel_contributing"}) {
      const nlohmann::json& load = line.at(what);
      EXPECT_GT(load.at("max"), 0);
      EXPECT_LE(load.at("median"), load.at("max"));
      EXPECT_FALSE(load.at("log2_bins").empty());
    }
    EXPECT_LE(line["pixel_contributing"]["max"], line["pixel_processed"]["max"]);
    EXPECT_LE(line["pixel_processed"]["max"], line["tile_lists"]["max"]);
  }
}

TEST(Trainer, KeepsTheNewestCheckpoints) {
  const Scene scene = test::make_tiny_scene();
  const test::TempDir temp;
  TrainConfig config = eventful_config();
  config.checkpoint_interval = 4;
  config.checkpoint_iterations = {5, 7};
  config.keep_checkpoints = 3;
  config.iterations = 18;
  train(config, scene, temp.path());
  EXPECT_EQ(ModelFolder(temp.path()).checkpoint_iterations(), (std::vector<int>{5, 7, 12, 16, 18}));
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
  EXPECT_TRUE(test::same(again.ply, run.ply));
}

}  // namespace
}  // namespace b3dgs
