// Tests training with distorted lenses on the GPU.
#include <gtest/gtest.h>

#include "support/gpu_test.h"
#include "support/train/lens_scene.h"

namespace b3dgs {
namespace {

TEST(LensesOnGpu, AreLearnedInStepsOfOneAndOfSeveralViews) {
  B3DGS_NEEDS_GPU();
  TrainConfig config = test::lens_config();
  config.device = "cuda";
  for (const int batch : {1, 2}) {
    SCOPED_TRACE(batch);
    config.batch = batch;
    test::expect_improvement(test::fisheye_scene(), config);
    test::expect_improvement(test::panorama_scene(), config);
  }
}

TEST(LensesOnGpu, TrainAsOnTheCpu) {
  B3DGS_NEEDS_GPU();
  TrainConfig config = test::lens_config();
  config.iterations = 20;
  config.test_iterations = {20};
  for (const Scene& scene : {test::fisheye_scene(), test::panorama_scene()}) {
    const auto psnr_on = [&](const char* device) {
      config.device = device;
      const test::TempDir temp;
      return test::train(config, scene, temp / "model").result.evaluations.at(0).second.mean.psnr;
    };
    EXPECT_NEAR(psnr_on("cuda"), psnr_on("cpu"), 0.02);
  }
}

}  // namespace
}  // namespace b3dgs
