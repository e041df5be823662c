// Training with depth priors: exact resume.
#include <gtest/gtest.h>

#include "support/temp_dir.h"
#include "support/train/depth_maps.h"
#include "support/train/training.h"

namespace b3dgs {
namespace {

using test::train;
using test::Trained;

TEST(DepthTraining, ResumedEqualsUninterruptedBitForBit) {
  const test::TempDir temp;
  test::TinySceneOptions options;
  options.masked = true;
  GaussianTensors truth;
  Scene scene = test::make_tiny_scene(options, &truth);
  test::add_depth_maps(scene, truth, temp / "depths", 1e-5, 0);
  std::filesystem::remove(temp / "depths/view3.png");  // a view without a map
  TrainConfig config = test::eventful_config();
  config.depths = (temp / "depths").string();
  config.coarse_scale = 2;
  config.coarse_until = 15;
  const Trained whole = train(config, scene, temp / "whole");
  for (const int stop : {3, 10}) {
    SCOPED_TRACE(stop);
    const std::filesystem::path folder = temp / std::to_string(stop);
    std::filesystem::path checkpoint;
    {
      // Not a shorter training: the weight depends on the number of iterations.
      Trainer trainer(config, scene, ModelFolder(folder), {});
      trainer.run_until(stop);
      checkpoint = trainer.write_checkpoint();
    }
    const Trained resumed = train(config, scene, folder, checkpoint);
    EXPECT_TRUE(resumed.ply == whole.ply);
    EXPECT_TRUE(resumed.checkpoint == whole.checkpoint);
  }
  config.threads = 1;
  EXPECT_TRUE(train(config, scene, temp / "one_thread").ply == whole.ply);
}

}  // namespace
}  // namespace b3dgs
