// Training with a learned background: that it fits better, what is saved of it, and exact resume.
#include <gtest/gtest.h>

#include "model/formats/background_json.h"
#include "model/formats/ply.h"
#include "support/expect_error.h"
#include "support/temp_dir.h"
#include "support/train/tiny_scene.h"
#include "support/train/training.h"
#include "train/background/background.h"

namespace b3dgs {
namespace {

using test::train;
using test::Trained;

/// One colour, or a sky that is blue above, brown below and bright on one side.
torch::Tensor true_background(int degree) {
  torch::Tensor coefficients = make_background(degree, torch::kCPU).coefficients;
  coefficients[0] = torch::tensor({-2.0f, 1.5f, 4.0f});
  if (degree == 0) return coefficients;
  coefficients[1] = torch::tensor({-2.0f, 1.0f, 5.0f});
  coefficients[3] = torch::tensor({4.0f, 4.0f, 1.0f});
  coefficients[12] = torch::tensor({1.0f, -2.0f, 1.0f});
  coefficients[20] = torch::tensor({-1.0f, 1.0f, 2.0f});
  return coefficients;
}

Scene scene_with_background(int degree, bool masked = false) {
  test::TinySceneOptions options;
  options.n_gaussians = 40;
  options.n_views = 16;
  options.masked = masked;
  options.background = true_background(degree);
  return test::make_tiny_scene(options);
}

TrainConfig fitting_config(const std::string& background) {
  TrainConfig config;
  config.iterations = 300;
  config.seed = 2;
  config.background = background;
  config.background_lr = 0.1;  // few iterations
  config.densify_from_iter = 100;
  config.kernel = "shared-memory";
  config.sh_degree = 0;
  config.stats_interval = 0;
  return config;
}

/// PSNR of held-out views, dB.
double test_psnr(const std::string& background, const Scene& scene) {
  const test::TempDir temp;
  return train(fitting_config(background), scene, temp / "model").result.evaluations.back().second.mean.psnr;
}

TEST(BackgroundTraining, LearnsTheColorOfTheBackground) {
  const Scene scene = scene_with_background(0);
  const double black = test_psnr("black", scene), learned = test_psnr("learned", scene);
  EXPECT_GT(learned, black + 5) << black;
  const test::TempDir temp;
  const Trained run = train(fitting_config("learned"), scene, temp / "model");
  const std::vector<float> found = read_background_json(background_path(run.result.ply)).value().coefficients;
  const torch::Tensor truth = torch::sigmoid(0.28209479f * true_background(0));
  for (int c = 0; c < 3; ++c) {
    const double color = 1 / (1 + std::exp(-0.28209479 * static_cast<double>(found[static_cast<std::size_t>(c)])));
    EXPECT_NEAR(color, truth[0][c].item<double>(), 0.03) << c;
  }
}

TEST(BackgroundTraining, SkyFitsABackgroundThatDependsOnTheDirection) {
  const Scene scene = scene_with_background(4);
  const double black = test_psnr("black", scene), learned = test_psnr("learned", scene), sky = test_psnr("sky", scene);
  EXPECT_GT(sky, learned + 2) << learned;
  EXPECT_GT(sky, black + 5) << black;
}

TEST(BackgroundTraining, IgnoresInvalidPixels) {
  const Scene scene = scene_with_background(0, /*masked=*/true);  // invalid pixels are white
  const test::TempDir temp;
  const Trained run = train(fitting_config("learned"), scene, temp / "model");
  const std::vector<float> found = read_background_json(background_path(run.result.ply)).value().coefficients;
  EXPECT_LT(found[0], 0) << "red";
  EXPECT_GT(run.result.evaluations.back().second.mean.psnr, test_psnr("black", scene) + 5);
}

TrainConfig eventful(const std::string& background) {
  TrainConfig config = test::eventful_config();
  config.random_background = false;
  config.background = background;
  return config;
}

TEST(BackgroundTraining, ResumedEqualsUninterruptedBitForBit) {
  const Scene scene = scene_with_background(4);
  for (const char* background : {"learned", "sky"}) {
    SCOPED_TRACE(background);
    const test::TempDir temp;
    TrainConfig config = eventful(background);
    const Trained whole = train(config, scene, temp / "whole");
    test::expect_exact_resume(config, scene, whole, temp.path(), {3, 10});
    config.threads = 1;  // and for any number of threads
    EXPECT_TRUE(train(config, scene, temp / "one_thread").ply == whole.ply);
  }
}

TEST(BackgroundTraining, CoarseViewsShowTheSameSky) {
  const Scene scene = scene_with_background(4);
  const test::TempDir temp;
  TrainConfig config = eventful("sky");
  config.coarse_scale = 2;
  config.coarse_until = 15;
  const Trained whole = train(config, scene, temp / "whole");
  test::expect_exact_resume(config, scene, whole, temp.path(), {4});
}

TEST(BackgroundTraining, ThePlyAndItsBackgroundRenderAsTheModel) {
  const Scene scene = scene_with_background(4);
  const test::TempDir temp;
  TrainConfig config = eventful("sky");
  config.iterations = 9;  // no round of density control at the end
  Trainer trainer(config, scene, ModelFolder(temp / "model"), {});
  const TrainResult result = trainer.run();
  const double of_model = trainer.evaluate(scene.train).mean.psnr;
  const GaussianTensors gaussians = to_tensors(read_splat_ply(result.ply), 1, torch::kCPU);
  const std::vector<float> values = read_background_json(background_path(result.ply)).value().coefficients;
  const torch::Tensor background = torch::tensor(values).view({-1, 3});
  Rasterizer rasterizer(torch::kCPU);
  const RenderSettings settings = evaluation_settings(config, trainer.sh_degree());
  EXPECT_EQ(evaluate_views(rasterizer, gaussians, scene.train, settings, {}, nullptr, background).mean.psnr, of_model);
  EXPECT_LT(evaluate_views(rasterizer, gaussians, scene.train, settings).mean.psnr, of_model - 1);
}

TEST(BackgroundTraining, CanBeChangedWhenResumed) {
  const Scene scene = scene_with_background(0);
  const test::TempDir temp;
  TrainConfig config = eventful("black");
  std::filesystem::path checkpoint;
  for (const char* background : {"black", "sky", "learned", "white"}) {
    config.background = background;
    config.iterations = 3 + (checkpoint.empty() ? 0 : read_checkpoint_header(checkpoint).at("iteration").get<int>());
    const Trained run = train(config, scene, temp / "model", checkpoint);
    checkpoint = run.result.checkpoint;
    EXPECT_EQ(std::filesystem::exists(background_path(run.result.ply)), learned_background_degree(config) >= 0);
    const auto header = read_checkpoint_header(checkpoint);
    EXPECT_EQ(header.value("background_steps", 0), learned_background_degree(config) >= 0 ? 3 : 0) << background;
  }
}

TEST(BackgroundTraining, RefusesACheckpointWithoutTheBackgroundThatItNames) {
  const Scene scene = scene_with_background(0);
  const test::TempDir temp;
  const TrainConfig config = eventful("learned");
  const std::filesystem::path path = train(config, scene, temp / "model").result.checkpoint;
  CheckpointFile file = read_checkpoint_file(path);
  for (int i = 0; i < 3; ++i) file.tensors.pop_back();
  write_checkpoint_file(path, file);
  EXPECT_TRUE(
      test::fails_with<InputError>({"no learned background"}, [&] { train(config, scene, temp / "model", path); }));
}

TEST(BackgroundTraining, RefusesOptionsThatContradictEachOther) {
  TrainConfig config;
  config.device = "cpu";
  config.white_background = true;
  for (const char* background : {"black", "learned", "sky"}) {
    config.background = background;
    EXPECT_TRUE(test::fails_with<InputError>({"-w and --background", background}, [&] { check_options(config); }));
  }
  config.background = "white";
  EXPECT_NO_THROW(check_options(config));
  config.white_background = false;
  config.random_background = true;
  EXPECT_NO_THROW(check_options(config));
  config.background = "sky";
  EXPECT_TRUE(
      test::fails_with<InputError>({"--random_background and --background sky"}, [&] { check_options(config); }));
}

TEST(BackgroundTraining, WhiteIsTheSameAsMinusW) {
  const Scene scene = test::make_tiny_scene();
  const test::TempDir temp;
  TrainConfig config = eventful("auto");
  config.white_background = true;
  const Trained with_w = train(config, scene, temp / "w");
  config.white_background = false;
  config.background = "white";
  EXPECT_TRUE(train(config, scene, temp / "white").ply == with_w.ply);
}

}  // namespace
}  // namespace b3dgs
