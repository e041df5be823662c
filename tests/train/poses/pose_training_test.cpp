// Tests training with --pose_opt: which poses change and which stay, how they are saved, and exact resume.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <utility>
#include <vector>

#include <nlohmann/json.hpp>

#include "core/files/folders.h"
#include "core/random.h"
#include "core/vec.h"
#include "model/cameras/cameras_json.h"
#include "support/approx.h"
#include "support/expect_error.h"
#include "support/files.h"
#include "support/same.h"
#include "support/temp_dir.h"
#include "support/train/tiny_scene.h"
#include "support/train/training.h"
#include "train/checkpoint/checkpoint.h"
#include "train/poses/pose_refiner.h"

namespace b3dgs {
namespace {

using test::eventful_config;
using test::train;
using test::Trained;

double length(Vec3d v) {
  return std::sqrt(dot(v, v));
}

TrainConfig refining_config(TrainConfig config = eventful_config()) {
  config.pose_opt = true;
  return config;
}

/// Rotates each training camera by `degrees` and moves it by `distance` times the scene extent, in random directions.
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
  TrainConfig config = eventful_config();
  config.densify_from_iter = config.iterations;
  const Trained without = train(config, scene, temp / "without");
  EXPECT_FALSE(corrections_of(without.result.checkpoint).defined()) << "default checkpoints have no poses";
  config = refining_config(config);
  const Trained late = train(config, scene, temp / "late");
  EXPECT_FALSE(corrections_of(late.result.checkpoint).defined());
  EXPECT_TRUE(test::same(late.ply, without.ply));
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

/// Returns the mean angle (rad) between the orientations of two lists of views.
double mean_angle(const std::vector<View>& a, const std::vector<View>& b) {
  double sum = 0;
  for (std::size_t i = 0; i < a.size(); ++i) {
    double trace = 0;
    for (std::size_t k = 0; k < 9; ++k) {
      trace += a[i].camera.cam_from_world.rotation[k] * b[i].camera.cam_from_world.rotation[k];
    }
    sum += std::acos(std::min(1.0, (trace - 1) / 2)) / static_cast<double>(a.size());
  }
  return sum;
}

TEST(PoseTraining, RefiningDisturbedPosesImprovesThemAndHeldOutViews) {
  test::TinySceneOptions options;
  options.n_gaussians = 60;
  options.n_views = 32;
  options.width = 90;
  options.height = 66;
  options.log_scale = -2.5f;
  Scene scene = test::make_tiny_scene(options);
  const std::vector<View> exact = scene.train;
  disturb_poses(scene, 0.5, 0.005);
  ASSERT_NEAR(mean_angle(scene.train, exact), 0.5 * kDegree, 1e-9);
  const test::TempDir temp;
  TrainConfig config;
  config.iterations = 600;
  config.sh_degree = 0;
  config.densify_until_iter = 0;
  config.kernel = "sub-tile";
  // Steps are larger than by default, because there are few iterations.
  config.position_lr_max_steps = config.iterations;
  config.position_lr_init *= 10;
  config.position_lr_final *= 10;
  config.feature_lr *= 6;
  config.opacity_lr *= 2;
  config.scaling_lr *= 3;
  config.rotation_lr *= 5;
  config.init_opacity = config.init_scale = 0.5;
  const auto psnr = [](const Trained& trained) { return trained.result.evaluations.back().second.mean.psnr; };
  const double without = psnr(train(config, scene, temp / "without"));
  config.pose_opt = true;
  config.pose_opt_lr = 0.002;
  config.densify_from_iter = 100;
  const Trained refined = train(config, scene, temp / "with");
  EXPECT_GT(without, 30);  // 41.7 with exact poses
  EXPECT_GT(psnr(refined), without + 3);

  std::vector<View> views = scene.train;
  apply_refined_poses(ModelFolder(temp / "with").poses(), views);
  // Two views are not refined, and turning a camera has much the same effect as moving it.
  EXPECT_LT(mean_angle(views, exact), 0.7 * mean_angle(scene.train, exact));
}

TEST(PoseTraining, FilesOfTheModelHaveTheRefinedPoses) {
  const Scene scene = test::make_tiny_scene();
  const test::TempDir temp;
  TrainConfig config = refining_config();
  Trainer trainer(finalize(config, scene), scene, ModelFolder(temp / "model"), {});
  const TrainResult result = trainer.run();
  const ModelFolder folder(temp / "model");
  PoseState state;
  state.corrections = corrections_of(result.checkpoint);
  const std::vector<View> expected = with_refined_poses(scene.train, scene.train, state);

  std::vector<View> views = scene.train;
  views[1].name = "of another scene.png";
  views[2].camera.cam_from_world.translation[0] += 1e-3;
  const std::vector<View> others{views[1], views[2]};
  apply_refined_poses(folder.poses(), views);
  const nlohmann::json poses = nlohmann::json::parse(test::read_bytes(folder.poses()));
  ASSERT_EQ(poses.size(), expected.size());
  for (std::size_t i = 0; i < views.size(); ++i) {
    const bool is_other = i == 1 || i == 2;
    const Pose &found = views[i].camera.cam_from_world,
               &wanted = is_other ? others[i - 1].camera.cam_from_world : expected[i].camera.cam_from_world;
    for (std::size_t k = 0; k < 9; ++k) EXPECT_NEAR(found.rotation[k], wanted.rotation[k], 1e-14);
    for (std::size_t k = 0; k < 3; ++k) EXPECT_NEAR(found.translation[k], wanted.translation[k], 1e-14);
    const CameraCorrection correction = state.correction(i);
    EXPECT_NEAR(poses[i].at("turned_degrees").get<double>(), length(correction.rotation) / kDegree, 1e-9);
    EXPECT_NEAR(poses[i].at("moved").get<double>(), length(correction.translation), 1e-12);
    EXPECT_EQ(poses[i].at("img_name").get<std::string>(), scene.train[i].name);
  }
  const std::vector<NamedCamera> cameras = read_cameras_json(folder.cameras());
  ASSERT_EQ(cameras.size(), scene.test.size() + scene.train.size());
  for (std::size_t i = 0; i < cameras.size(); ++i) {
    const bool is_test = i < scene.test.size();
    const View& wanted = is_test ? scene.test[i] : expected[i - scene.test.size()];
    EXPECT_EQ(cameras[i].name, wanted.name);
    for (std::size_t k = 0; k < 3; ++k) {
      EXPECT_NEAR(cameras[i].camera.center()[k], wanted.camera.center()[k], 1e-12);
    }
  }
  // Training views are evaluated with these poses.
  EXPECT_EQ(trainer.evaluate(scene.train).mean.psnr, trainer.evaluate(expected).mean.psnr);
  const auto of_views = [&](const std::vector<View>& as) { return trainer.evaluate(as).mean.psnr; };
  std::vector<View> unknown = scene.train;
  for (View& view : unknown) view.name += " of another name";
  EXPECT_NE(of_views(unknown), of_views(scene.train));

  // A training without refinement in the same folder removes the poses of an earlier one.
  config.pose_opt = false;
  remove_tree(folder.checkpoint(config.iterations).parent_path());
  remove_tree(folder.root() / "point_cloud");
  train(config, scene, folder.root());
  EXPECT_FALSE(std::filesystem::exists(folder.poses()));
}

TEST(PoseTraining, CorrectionsStayInUseWhenTheOptionIsTurnedOff) {
  const Scene scene = test::make_tiny_scene();
  const test::TempDir temp;
  TrainConfig config = refining_config();
  const Trained first = train(config, scene, temp / "model");
  config.iterations += 4;
  config.pose_opt = false;
  const Trained second = train(config, scene, temp / "model", first.result.checkpoint);
  const torch::Tensor learned = corrections_of(first.result.checkpoint);
  EXPECT_TRUE(test::same(corrections_of(second.result.checkpoint), learned));
  config.iterations += 4;
  config.pose_opt = true;
  const Trained third = train(config, scene, temp / "model", second.result.checkpoint);
  EXPECT_FALSE(torch::equal(corrections_of(third.result.checkpoint), learned));
}

TEST(PoseTraining, WarnsIfThereIsNoPoseToRefine) {
  test::TinySceneOptions options;
  options.n_views = 3;  // one of them for testing
  const Scene scene = test::make_tiny_scene(options);
  ASSERT_EQ(scene.train.size(), 2u);
  const test::TempDir temp;
  TrainConfig config = refining_config();
  config.iterations = 4;
  std::string warnings;
  TrainHooks hooks;
  hooks.on_warning = [&](const std::string& warning) { warnings += warning; };
  const Trained trained = train(config, scene, temp / "model", {}, hooks);
  EXPECT_NE(warnings.find("--pose_opt has no effect"), std::string::npos) << warnings;
  EXPECT_FALSE(corrections_of(trained.result.checkpoint).defined());
}

TEST(PoseTraining, DamagedCorrectionsOfACheckpointAreRefused) {
  const Scene scene = test::make_tiny_scene();
  const test::TempDir temp;
  TrainConfig config = refining_config();
  config.iterations = 8;
  const Trained trained = train(config, scene, temp / "model");
  const CheckpointFile good = read_checkpoint_file(trained.result.checkpoint);
  const auto expect_refused = [&](const std::string& name, const torch::Tensor& tensor, const std::string& reason) {
    CheckpointFile bad = good;
    for (auto& [own, value] : bad.tensors) {
      if (own == name) value = tensor;
    }
    const std::filesystem::path path = temp / "bad.b3dgs";
    write_checkpoint_file(path, bad);
    EXPECT_TRUE(test::fails_with<InputError>({name, reason}, [&] { read_checkpoint(path, scene, torch::kCPU); }));
  };
  const auto n = static_cast<std::int64_t>(scene.train.size());
  expect_refused("poses.corrections", torch::full({n, 6}, NAN), "not finite");
  expect_refused("poses.corrections", torch::zeros({n - 1, 6}), "expected");
  expect_refused("poses.adam_m", torch::zeros({n, 3}), "expected");
  expect_refused("poses.adam_v", torch::full({n, 6}, -1.0f), "at least 0");
  expect_refused("poses.steps", torch::full({n}, -1, torch::kInt32), "at least 0");
  expect_refused("poses.steps", torch::zeros({n}), "expected");
}

TEST(PosesJson, DamagedFilesAreRefused) {
  const test::TempDir temp;
  std::vector<View> views(1);
  const auto read = [&] { apply_refined_poses(temp / "poses.json", views); };
  EXPECT_TRUE(test::fails_with<InputError>({"poses.json", "cannot be opened"}, read));
  for (const auto& [text, reason] : std::vector<std::pair<std::string, std::string>>{
           {"{", "list of poses"},
           {"{}", "list of poses"},
           {"[{}]", "pose 0: expected img_name"},
           {R"([{"img_name": "a", "qvec": [1, 0, 0], "tvec": [0, 0, 0]}])", "pose 0: expected img_name"},
           {R"([{"img_name": "", "given_qvec": [1, 0, 0, 0], "given_tvec": [0, 0, 0], "qvec": [0, 0, 0, 0],
                 "tvec": [0, 0, 0]}])",
            "expected a unit quaternion"}}) {
    test::write_bytes(temp / "poses.json", text);
    EXPECT_TRUE(test::fails_with<InputError>({"poses.json", reason}, read)) << text;
  }
}

}  // namespace
}  // namespace b3dgs
