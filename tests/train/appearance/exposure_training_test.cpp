// Tests trainings with --exposure: the learned transforms, exact resume, files.
#include <gtest/gtest.h>

#include <algorithm>

#include <nlohmann/json.hpp>

#include "core/check.h"
#include "core/config.h"
#include "core/files/folders.h"
#include "support/expect_error.h"
#include "support/same.h"
#include "support/temp_dir.h"
#include "support/train/appearance.h"
#include "support/train/tiny_scene.h"
#include "support/train/training.h"
#include "train/appearance/appearance_model.h"
#include "train/checkpoint/checkpoint.h"

namespace b3dgs {
namespace {

using test::train;
using test::Trained;

TrainConfig exposed_config() {
  TrainConfig config = test::eventful_config();
  config.exposure = true;
  config.exposure_lr_final =
      config.exposure_lr_init;  // constant, because the rate depends on --iterations, which a resume here changes
  return config;
}

TEST(ExposureTraining, WithARateOfZeroTheGaussiansAreThoseOfATrainingWithout) {
  const Scene scene = test::make_jittered_scene();
  const test::TempDir temp;
  for (TrainConfig config : {test::eventful_config(), test::eventful_budget_config()}) {
    const Trained without = train(config, scene, temp / "without");
    config.exposure = true;
    config.exposure_lr_init = config.exposure_lr_final = 0;
    EXPECT_TRUE(test::same(train(config, scene, temp / "with").ply, without.ply)) << name_of(config.strategy);
  }
}

TEST(ExposureTraining, CanBeTurnedOnAndOffWhenResumed) {
  const Scene scene = test::make_jittered_scene();
  const test::TempDir temp;
  TrainConfig config = exposed_config();
  config.iterations = 6;
  config.exposure = false;
  const Trained first = train(config, scene, temp / "model");
  EXPECT_FALSE(read_checkpoint(first.result.checkpoint, scene, torch::kCPU).state.appearance.is_defined());
  EXPECT_FALSE(read_checkpoint_file(first.result.checkpoint).header.contains("appearance_steps"));
  config.iterations = 8;
  config.exposure = true;
  const Trained second = train(config, scene, temp / "model", first.result.checkpoint);
  EXPECT_EQ(read_checkpoint(second.result.checkpoint, scene, torch::kCPU).state.appearance.steps, 2);
  config.iterations = 9;
  config.exposure = false;
  const Trained third = train(config, scene, temp / "model", second.result.checkpoint);
  EXPECT_FALSE(read_checkpoint(third.result.checkpoint, scene, torch::kCPU).state.appearance.is_defined());
}

TEST(ExposureTraining, DamagedCheckpointsAreRefused) {
  const Scene scene = test::make_jittered_scene();
  const test::TempDir temp;
  TrainConfig config = exposed_config();
  config.iterations = 3;
  const CheckpointFile whole = read_checkpoint_file(train(config, scene, temp / "model").result.checkpoint);
  const auto refused = [&](const std::string& part, auto&& damage) {
    CheckpointFile file = whole;
    damage(file);
    write_checkpoint_file(temp / "damaged.b3dgs", file);
    return test::fails_with<InputError>({"damaged.b3dgs", part},
                                        [&] { read_checkpoint(temp / "damaged.b3dgs", scene, torch::kCPU); });
  };
  const auto tensor_of = [](CheckpointFile& file, const std::string& name) -> torch::Tensor& {
    for (auto& [own, tensor] : file.tensors) {
      if (own == name) return tensor;
    }
    throw std::out_of_range(name);
  };
  EXPECT_TRUE(refused("appearance.exposures is [1, 3, 4]", [&](CheckpointFile& file) {
    torch::Tensor& tensor = tensor_of(file, "appearance.exposures");
    tensor = tensor.slice(0, 0, 1).contiguous();
  }));
  EXPECT_TRUE(refused("appearance.v: expected values of at least 0", [&](CheckpointFile& file) {
    torch::Tensor& tensor = tensor_of(file, "appearance.v");
    tensor = tensor - 1;
  }));
  EXPECT_TRUE(refused("appearance.v is missing", [&](CheckpointFile& file) { file.tensors.pop_back(); }));
  EXPECT_TRUE(refused("both exposures and bilateral grids", [&](CheckpointFile& file) {
    const auto moments = std::find_if(file.tensors.begin(), file.tensors.end(),
                                      [](const auto& row) { return row.first == "appearance.m"; });
    file.tensors.insert(moments, {"appearance.grids", torch::zeros({6, 8, 16, 16, 12})});
    file.header["appearance_last_steps"] = std::vector<int>(6, 0);
  }));
  EXPECT_TRUE(refused("appearance_steps", [&](CheckpointFile& file) { file.header["appearance_steps"] = -1; }));
}

TEST(ExposureTraining, WritesTheExposuresBesideThePlyAndInTheModelFolder) {
  const Scene scene = test::make_jittered_scene();
  const test::TempDir temp;
  TrainConfig config = exposed_config();
  config.save_iterations = {5};
  const Trained run = train(config, scene, temp / "model");
  const ModelFolder folder(temp / "model");
  const Exposures last = read_exposures(folder.exposures());
  EXPECT_EQ(last, read_exposures(folder.exposures(config.iterations)));
  EXPECT_NE(last, read_exposures(folder.exposures(5)));
  const TrainState state = read_checkpoint(run.result.checkpoint, scene, torch::kCPU).state;
  EXPECT_EQ(last, named_exposures(state.appearance.exposures, scene.train));
  EXPECT_EQ(last.size(), scene.train.size());
  config.exposure = false;
  train(config, scene, temp / "without");
  EXPECT_FALSE(std::filesystem::exists(ModelFolder(temp / "without").exposures()));
}

TEST(ExposureTraining, MetricsSayHowTheyWereMeasured) {
  const Scene scene = test::make_jittered_scene();
  const test::TempDir temp;
  TrainConfig config = exposed_config();
  config.eval = true;
  for (const bool fits_left_half : {false, true}) {
    config.train_test_exp = fits_left_half;
    TrainHooks hooks;
    std::string said;
    hooks.on_message = [&](const std::string& message) { said += message + "\n"; };
    const Trained run = train(config, scene, temp / "model", {}, hooks);
    const Evaluation& evaluation = run.result.evaluations.back().second;
    EXPECT_EQ(evaluation.fits_left_half, fits_left_half);
    ASSERT_TRUE(evaluation.mean.corrected_psnr.has_value());
    EXPECT_NE(said.find("colour-corrected PSNR"), std::string::npos) << said;
    EXPECT_EQ(said.find("on the right half of 2 test views") != std::string::npos, fits_left_half) << said;
    const auto results = nlohmann::json::parse(test::read_bytes(temp / "model/results.json")).at("ours_20");
    EXPECT_EQ(results.at("CC_PSNR"), *evaluation.mean.corrected_psnr);
    EXPECT_EQ(results.value("train_test_exp", false), fits_left_half);
    EXPECT_NE(test::read_bytes(temp / "model/train.jsonl").find("test_cc_psnr"), std::string::npos);
    EXPECT_NE(test::read_bytes(temp / "model/cfg_args").find(fits_left_half ? "train_test_exp=True" : "exp=False"),
              std::string::npos);
    remove_tree(temp / "model");
  }
}

TEST(ExposureTraining, OptionsThatDoNotGoTogetherAreRefused) {
  TrainConfig config = exposed_config();
  config.train_test_exp = true;
  EXPECT_TRUE(
      test::fails_with<InputError>({"--train_test_exp", "--eval"}, [&] { check_options(config, torch::kCPU); }));
}

TEST(ExposureTraining, RandomGainsAndTintsCostAtMostThreeTenthsOfADecibel) {
  test::TinySceneOptions options;
  options.n_views = 24;
  options.width = 90;
  options.height = 66;
  const Scene scene = test::make_tiny_scene(options);
  Scene jittered = scene;
  test::jitter_exposures(jittered.train, 0.15);
  const test::TempDir temp;
  TrainConfig config;
  config.sh_degree = 1;
  config.iterations = 1200;
  config.densify_from_iter = 100;
  config.max_gaussians = 200;
  config.save_iterations = config.test_iterations = {};
  config.kernel = "sub-tile";
  const double same = test::corrected_psnr(train(config, scene, temp / "same").result.ply, config, scene.test);
  const double without = test::corrected_psnr(train(config, jittered, temp / "without").result.ply, config, scene.test);
  config.exposure = true;
  const double with = test::corrected_psnr(train(config, jittered, temp / "with").result.ply, config, scene.test);
  RecordProperty("same", std::to_string(same));
  RecordProperty("without", std::to_string(without));
  RecordProperty("with", std::to_string(with));
  EXPECT_GT(with, same - 0.3);
  EXPECT_GT(with, without + 1.5) << "the option makes no difference here";
}

}  // namespace
}  // namespace b3dgs
