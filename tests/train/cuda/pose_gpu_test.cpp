// Compares pose refinement on the GPU with that on the CPU, and with itself after a resume.
#include <gtest/gtest.h>

#include "support/approx.h"
#include "support/gpu_test.h"
#include "support/temp_dir.h"
#include "support/train/tiny_scene.h"
#include "support/train/training.h"
#include "train/checkpoint/checkpoint.h"

namespace b3dgs {
namespace {

using test::train;
using test::Trained;

TrainConfig refining_config() {
  TrainConfig config = test::eventful_config();
  config.device = "cuda";
  config.deterministic = true;
  config.pose_opt = true;
  return config;
}

torch::Tensor corrections_of(const Trained& trained) {
  for (const auto& [name, tensor] : read_checkpoint_file(trained.result.checkpoint).tensors) {
    if (name == "poses.corrections") return tensor;
  }
  return {};
}

TEST(PosesOnGpu, AreRefinedAsOnTheCpu) {
  B3DGS_NEEDS_GPU();
  const Scene scene = test::make_tiny_scene();
  const test::TempDir temp;
  TrainConfig config = refining_config();
  config.iterations = 9;  // before density control
  const Trained gpu = train(config, scene, temp / "gpu");
  config.device = "cpu";
  const torch::Tensor expected = corrections_of(train(config, scene, temp / "cpu")), found = corrections_of(gpu);
  ASSERT_TRUE(found.defined());
  const torch::Tensor rates =
      config.pose_opt_lr *
      torch::tensor({1.0, 1.0, 1.0, scene.extent, scene.extent, scene.extent}, torch::kFloat64).expand({6, 6});
  EXPECT_GT((expected.abs() / rates).max().item<double>(), 0.9) << "no step was taken";
  // A step has the size of the rate for any gradient, so it can amplify rounding.
  EXPECT_TRUE(test::within(found, expected, 0.05 * rates));
}

TEST(PosesOnGpu, OneThatIsRefinedInTwoIterationsInARowResumesExactlyIfDeterministic) {
  B3DGS_NEEDS_GPU();
  test::TinySceneOptions options;
  options.n_views = 4;  // 3 for training, of which one is refined
  const Scene scene = test::make_tiny_scene(options);
  const test::TempDir temp;
  const TrainConfig config = refining_config();
  const Trained whole = train(config, scene, temp / "whole");
  EXPECT_GT(corrections_of(whole).abs().max().item<double>(), 0);
  test::expect_exact_resume(config, scene, whole, temp.path(), {3, 10, 13});
}

TEST(PosesOnGpu, ResumeOnTheOtherDevice) {
  B3DGS_NEEDS_GPU();
  const Scene scene = test::make_tiny_scene();
  const test::TempDir temp;
  TrainConfig config = refining_config();
  config.keep_checkpoints = 100;  // corrections_of() reads them all at the end
  config.iterations = 8;
  const Trained first = train(config, scene, temp / "model");
  config.iterations = 16;
  config.device = "cpu";
  const Trained second = train(config, scene, temp / "model", first.result.checkpoint);
  config.iterations = 24;
  config.device = "cuda";
  const Trained third = train(config, scene, temp / "model", second.result.checkpoint);
  EXPECT_EQ(third.result.iteration, 24);
  EXPECT_FALSE(torch::equal(corrections_of(third), corrections_of(second)));
  EXPECT_FALSE(torch::equal(corrections_of(second), corrections_of(first)));
}

}  // namespace
}  // namespace b3dgs
