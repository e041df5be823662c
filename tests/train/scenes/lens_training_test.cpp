// Tests training with distorted lenses.
#include <gtest/gtest.h>

#include "support/expect_error.h"
#include "support/temp_dir.h"
#include "support/train/lens_scene.h"
#include "support/train/training.h"

namespace b3dgs {
namespace {

TEST(LensTraining, LearnsAFisheyeBeyond180Degrees) {
  const Scene scene = test::fisheye_scene();
  ASSERT_GT(scene.train[0].camera.lens.max_angle, 1.75);
  test::expect_improvement(scene, test::lens_config());
}

TEST(LensTraining, LearnsAPanorama) {
  test::expect_improvement(test::panorama_scene(), test::lens_config());
}

TEST(LensTraining, LearnsInStepsOfSeveralViews) {
  TrainConfig config = test::lens_config();
  config.batch = 2;
  test::expect_improvement(test::fisheye_scene(), config);
  test::expect_improvement(test::panorama_scene(), config);
}

TEST(LensTraining, RefusesAntialiasingBeforePhotographsAreRead) {
  TrainConfig config = test::lens_config();
  config.antialiasing = true;
  Scene scene = test::fisheye_scene();
  for (View& view : scene.train) view.image.reset();
  const test::TempDir temp;
  EXPECT_TRUE(test::fails_with<InputError>({"--antialiasing", "--lenses undistort"},
                                           [&] { test::train(config, scene, temp / "model"); }));
}

}  // namespace
}  // namespace b3dgs
