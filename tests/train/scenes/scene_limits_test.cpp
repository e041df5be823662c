// Tests that the options and the scene fit each other: the scene is read with the options of the training, and its
// points and cameras are where they can be rendered.
#include "train/scene_limits.h"

#include <gtest/gtest.h>
#include <omp.h>

#include "core/check.h"
#include "support/expect_error.h"
#include "support/temp_dir.h"
#include "support/train/disk_scene.h"
#include "support/train/tiny_scene.h"
#include "support/train/training.h"
#include "train/device.h"
#include "train/trainer.h"

namespace b3dgs {
namespace {

/// Returns the tiny scene in other units of length.
Scene scaled_scene(double scale) {
  Scene scene = test::make_tiny_scene();
  for (float& value : scene.points.positions) value *= static_cast<float>(scale);
  for (std::vector<View>* views : {&scene.train, &scene.test}) {
    for (View& view : *views) {
      for (double& value : view.camera.cam_from_world.translation) value *= scale;
    }
  }
  scene.extent *= scale;
  return scene;
}

std::vector<std::string> warnings_of_training(const Scene& scene, TrainConfig config) {
  const test::TempDir folder;
  std::vector<std::string> warnings;
  TrainHooks hooks;
  hooks.on_warning = [&](const std::string& text) { warnings.push_back(text); };
  Trainer(finalize(config, scene), scene, ModelFolder(folder.path()), hooks).run();
  return warnings;
}

TEST(NearPlane, PointsThatAreTooNearAreCounted) {
  const Scene scene = test::make_tiny_scene();
  EXPECT_EQ(near_plane_warning(scene.points.positions, scene.train, 0.2), "");
  const Scene small = scaled_scene(0.01);
  const std::string warning = near_plane_warning(small.points.positions, small.train, 0.2);
  const std::string n = std::to_string(small.points.size());
  EXPECT_EQ(warning.rfind(n + " of " + n + " points are nearer than --near_plane 0.2 in the views", 0), 0u) << warning;
  const std::string advice = "such as --near_plane ";
  ASSERT_NE(warning.find(advice), std::string::npos) << warning;
  const double smaller = std::stod(warning.substr(warning.find(advice) + advice.size()));
  EXPECT_EQ(near_plane_warning(small.points.positions, small.train, smaller), "") << smaller;
}

TEST(OneTrainingView, IsSaidAtTheStart) {
  TrainConfig config = test::eventful_config();
  config.iterations = 1;
  Scene scene = test::make_tiny_scene();
  scene.train.resize(2);
  EXPECT_EQ(warnings_of_training(scene, config), std::vector<std::string>{});
  scene.train.resize(1);
  EXPECT_EQ(
      warnings_of_training(scene, config),
      std::vector<std::string>{"only one training view: other views will look wrong; a scene needs 20 photographs "
                               "or more, each overlapping its neighbours"});
}

TEST(NearPlane, CamerasThatAllLookElsewhereAreSaid) {
  Scene scene = test::make_tiny_scene();
  for (View& view : scene.train) {
    Pose& pose = view.camera.cam_from_world;
    for (int i = 3; i < 9; ++i) pose.rotation[i] = -pose.rotation[i];  // rotated by half a turn about x
    for (int i = 1; i < 3; ++i) pose.translation[i] = -pose.translation[i];
  }
  const std::string warning = near_plane_warning(scene.points.positions, scene.train, 0.2);
  EXPECT_EQ(warning.rfind("none of the 120 points is in front of a camera", 0), 0u) << warning;
  EXPECT_EQ(near_plane_warning({}, scene.train, 0.2), "");
}

TEST(NearPlane, ATrainingThatShowsNothingWarnsAtTheStartAndAtTheEnd) {
  TrainConfig config = test::eventful_config();
  const std::vector<std::string> usual = warnings_of_training(test::make_tiny_scene(), config);
  for (const std::string& warning : usual)
    EXPECT_EQ(warning.find("no Gaussian is visible"), std::string::npos) << warning;
  const std::vector<std::string> warnings = warnings_of_training(scaled_scene(0.01), config);
  ASSERT_EQ(warnings.size(), usual.size() + 3) << testing::PrintToString(warnings);
  EXPECT_NE(warnings[0].find("--near_plane 0.2"), std::string::npos) << warnings[0];
  EXPECT_EQ(warnings[1].rfind("after iteration 6: no Gaussian is visible in 6 of 6 training views", 0), 0u)
      << warnings[1];
  EXPECT_EQ(warnings.back().rfind("after iteration 20: no Gaussian is visible in 6 of 6", 0), 0u) << warnings.back();
}

TEST(SceneOptions, OfTheTrainingAreThoseTheSceneIsReadWith) {
  const test::DiskScene disk;
  TrainConfig config = test::eventful_config();
  config.source_path = disk.load().source_path;
  config.resolution = 2;
  config.eval = true;
  const test::TempDir folder;
  const Scene scene = load_scene(scene_options(config));
  EXPECT_NO_THROW(Trainer(finalize(config, scene), scene, ModelFolder(folder.path()), {}));
  const auto refuses = [&](TrainConfig other, const std::string& name) {
    return test::fails_with<InputError>(
        {"the scene was not read with the options of the training: " + name, "load it with scene_options(config)"},
        [&] { Trainer(finalize(other, scene), scene, ModelFolder(folder.path()), {}); });
  };
  TrainConfig other = config;
  other.resolution = -1;
  EXPECT_TRUE(refuses(other, "resolution (expected -1 as in TrainConfig, found 2 in SceneOptions)"));
  other = config;
  other.eval = false;
  EXPECT_TRUE(refuses(other, "eval"));
  other = config;
  other.source_path = "/elsewhere";
  EXPECT_TRUE(refuses(other, "source_path"));
  other = config;
  other.masks = "masks_2";
  EXPECT_TRUE(refuses(other, "masks"));
  other = config;
  other.source_path += "/";
  EXPECT_NO_THROW(Trainer(finalize(other, scene), scene, ModelFolder(folder.path()), {}));
}

TEST(ComputeThreads, AreNotThousands) {
  const int n = set_compute_threads(1000000);
  EXPECT_GE(n, 64);
  EXPECT_LE(n, 64 + 4 * omp_get_num_procs());
  EXPECT_EQ(set_compute_threads(3), 3);
  set_compute_threads(0);
}

}  // namespace
}  // namespace b3dgs
