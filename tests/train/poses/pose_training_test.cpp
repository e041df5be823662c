// Training with --pose_opt: what is learned, what stays, what is saved, and exact resume.
#include <gtest/gtest.h>

#include <cmath>
#include <limits>

#include <nlohmann/json.hpp>

#include "core/random.h"
#include "model/cameras_json.h"
#include "model/poses_json.h"
#include "support/expect_error.h"
#include "support/files.h"
#include "support/temp_dir.h"
#include "support/train/tiny_scene.h"
#include "support/train/training.h"
#include "train/checkpoint/checkpoint.h"
#include "train/checkpoint/checkpoint_file.h"
#include "train/poses/pose_refiner.h"

namespace b3dgs {
namespace {

using test::eventful_config;
using test::train;
using test::Trained;

constexpr double kDegree = 3.14159265358979323846 / 180;

double length(Vec3d v) {
  return std::sqrt(dot(v, v));
}

TrainConfig refining_config(TrainConfig config = eventful_config()) {
  config.pose_opt = true;
  config.pose_opt_from_iter = 2;
  return config;
}

/// Turns each training camera by `degrees` and moves it by `distance` x scene extent, in random directions.
void disturb_poses(Scene& scene, double degrees, double distance) {
  const RandomKey key{17, RandomStream::kSplit, 0};
  const auto direction = [&](std::size_t i) {
    const auto n = random_normal(key, static_cast<std::uint32_t>(i));
    const Vec3d v{n[0], n[1], n[2]};
    return (1 / length(v)) * v;
  };
  for (std::size_t i = 0; i < scene.train.size(); ++i) {
    Pose& pose = scene.train[i].camera.cam_from_world;
    pose = corrected(pose, {degrees * kDegree * direction(2 * i), distance * scene.extent * direction(2 * i + 1)});
  }
}

torch::Tensor corrections_of(const std::filesystem::path& checkpoint, const std::string& name = "poses.corrections") {
  for (const auto& [own, tensor] : read_checkpoint_file(checkpoint).tensors) {
    if (own == name) return tensor;
  }
  return {};
}

/// Views of two sizes with masks.
Scene mixed_scene() {
  test::TinySceneOptions options;
  options.masked = true;
  options.width = 90;
  options.height = 66;
  Scene scene = test::make_tiny_scene(options);
  options.width = 61;
  options.height = 50;
  const Scene others = test::make_tiny_scene(options);
  for (std::size_t i = 0; i < scene.train.size(); i += 2) scene.train[i] = others.train[i];
  return scene;
}

TEST(PoseTraining, ResumedEqualsUninterruptedBitForBitOnAnyNumberOfThreads) {
  const Scene scene = mixed_scene();
  const test::TempDir temp;
  TrainConfig config = refining_config();
  config.coarse_scale = 3;
  config.coarse_until = 40;
  const Trained whole = train(config, scene, temp / "whole");
  // before the first pose is refined, within an epoch, at a round, at an opacity reset
  test::expect_exact_resume(config, scene, whole, temp.path(), {1, 4, 10, 12});
  for (const int threads : {1, 3}) {
    config.threads = threads;
    EXPECT_TRUE(train(config, scene, temp / "again").ply == whole.ply) << threads << " threads";
  }
  config.threads = 0;
  config.pose_opt = false;
  EXPECT_FALSE(train(config, scene, temp / "without").ply == whole.ply) << "the option changes nothing";
}

TEST(PoseTraining, WorksWithEveryStrategyAndAntialiasing) {
  const Scene scene = test::make_tiny_scene();
  for (const char* strategy : {"mcmc", "balanced"}) {
    SCOPED_TRACE(strategy);
    const test::TempDir temp;
    TrainConfig config = refining_config(test::eventful_balanced_config());
    config.strategy = strategy;
    config.antialiasing = true;
    const Trained whole = train(config, scene, temp / "whole");
    EXPECT_GT(corrections_of(whole.result.checkpoint).abs().max().item<double>(), 0);
    test::expect_exact_resume(config, scene, whole, temp.path(), {3, 13});
  }
}

TEST(PoseTraining, FirstAndLastViewStayAndTheOthersMove) {
  const Scene scene = test::make_tiny_scene();
  const test::TempDir temp;
  const Trained trained = train(refining_config(), scene, temp / "model");
  const torch::Tensor corrections = corrections_of(trained.result.checkpoint);
  const auto n = static_cast<std::int64_t>(scene.train.size());
  ASSERT_EQ(corrections.sizes(), (torch::IntArrayRef{n, 6}));
  for (std::int64_t view = 0; view < n; ++view) {
    const bool is_fixed = view == 0 || view == n - 1;
    EXPECT_EQ(corrections[view].abs().max().item<double>() == 0, is_fixed) << "view " << view;
  }
  const torch::Tensor steps = corrections_of(trained.result.checkpoint, "poses.steps");
  EXPECT_GT(steps.sum().item<int>(), 0);
  EXPECT_LE(steps.sum().item<int>(), 18);
}

TEST(PoseTraining, NothingIsLearnedBeforeItsIterationNorWithoutTheOption) {
  const Scene scene = test::make_tiny_scene();
  const test::TempDir temp;
  TrainConfig config = refining_config();
  const Trained without = train(eventful_config(), scene, temp / "without");
  EXPECT_FALSE(corrections_of(without.result.checkpoint).defined()) << "default checkpoints have no poses";
  config.pose_opt_from_iter = config.iterations;
  const Trained late = train(config, scene, temp / "late");
  EXPECT_FALSE(corrections_of(late.result.checkpoint).defined());
  EXPECT_TRUE(late.ply == without.ply);
}

TEST(PoseTraining, CorrectionsStayWithinTheirLimits) {
  const Scene scene = test::make_tiny_scene();
  const test::TempDir temp;
  TrainConfig config = refining_config();
  config.pose_opt_lr = 1;
  const Trained trained = train(config, scene, temp / "model");
  const torch::Tensor corrections = corrections_of(trained.result.checkpoint).to(torch::kFloat64);
  const torch::Tensor angles = corrections.slice(1, 0, 3).norm(2, 1), distances = corrections.slice(1, 3).norm(2, 1);
  EXPECT_NEAR(angles.max().item<double>(), 3 * kDegree, 1e-7);
  EXPECT_NEAR(distances.max().item<double>(), 0.03 * scene.extent, 1e-7);
}

TEST(PoseTraining, RefiningDisturbedPosesImprovesHeldOutViews) {
  test::TinySceneOptions options;
  const auto env = [](const char* name, double value) { const char* t = std::getenv(name); return t ? std::atof(t) : value; };
  options.n_gaussians = env("NG", 400);
  options.n_views = env("NV", 24);
  options.width = 90;
  options.height = 66;
  options.log_scale = env("LS", -3.2);
  Scene scene = test::make_tiny_scene(options);
  const Scene exact = scene;
  disturb_poses(scene, env("DEG", 0.5), env("DIST", 0.005));
  const test::TempDir temp;
  TrainConfig config;
  config.sh_degree = 1;
  config.iterations = env("IT", 800);
  config.densify_from_iter = 100;
  config.densify_until_iter = env("DU", 0);
  config.kernel = "shared-memory";
  config.position_lr_max_steps = config.iterations;
  const auto psnr = [&](const Scene& of, const TrainConfig& with, const char* name) {
    return train(with, of, temp / name).result.evaluations.back().second.mean.psnr;
  };
  const double with_exact_poses = env("EX", 1) ? psnr(exact, config, "exact") : 0, without = env("EX", 1) ? psnr(scene, config, "without") : 0;
  config.pose_opt = true;
  config.pose_opt_lr = env("LR", 0.0005);
  config.pose_opt_from_iter = env("FROM", 100);
  const double with = psnr(scene, config, "with");
  const double harm = env("EX", 1) ? psnr(exact, config, "harm") : 0;
  std::printf("exact %.2f, without %.2f, with %.2f, exact with %.2f\n", with_exact_poses, without, with, harm);
  EXPECT_GT(with, without + 1);
}

}  // namespace
}  // namespace b3dgs
