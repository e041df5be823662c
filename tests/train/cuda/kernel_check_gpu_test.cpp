// Tests kernel checks on the GPU, timed by the device.
#include <gtest/gtest.h>

#include <fstream>

#include "core/check.h"
#include "support/gpu_test.h"
#include "support/temp_dir.h"
#include "support/train/tiny_scene.h"
#include "support/train/training.h"

namespace b3dgs {
namespace {

TEST(RasterizerOnGpu, ReblendBackwardRejectsAGradientOfAnotherShapeAsBackwardDoes) {
  B3DGS_NEEDS_GPU();
  const torch::Device device(torch::kCUDA, 0);
  const Scene scene = test::make_tiny_scene();
  const GaussianTensors gaussians = to_tensors(splats_from_points(scene.points, 0), 0, device);
  Rasterizer rasterizer(device);
  const torch::Tensor color = rasterizer.forward(gaussians, to_camera_view(scene.train[0].camera), {}).color;
  RenderedViewGrad grad;
  grad.color = torch::zeros_like(color).narrow(0, 0, 1);
  EXPECT_THROW(rasterizer.reblend_backward(grad), LogicError);
  grad.color = torch::zeros_like(color).cpu();
  EXPECT_THROW(rasterizer.reblend_backward(grad), LogicError);
  grad.color = torch::zeros_like(color);
  EXPECT_NO_THROW(rasterizer.reblend_backward(grad));
}

TEST(KernelCheckOnGpu, TimesBothKernelsToTheEnd) {
  B3DGS_NEEDS_GPU();
  const Scene scene = test::make_tiny_scene();
  for (const char* kernel : {kAdaptive, kPublishedKernel}) {
    SCOPED_TRACE(kernel);
    const test::TempDir temp;
    TrainConfig config = test::eventful_config();
    config.device = "cuda";
    config.kernel = kernel;
    config.kernel_check_interval = 9;
    EXPECT_EQ(test::train(config, scene, temp.path()).result.iteration, 20);
    std::ifstream file(temp / "train.jsonl");
    std::vector<int> iterations;
    for (std::string line; std::getline(file, line);) {
      const nlohmann::json json = nlohmann::json::parse(line);
      if (json.value("event", "") != "kernel_check") continue;
      iterations.push_back(json.at("iteration"));
      for (const auto& [name, ms] : json.at("times_ms").items()) EXPECT_GT(ms.get<double>(), 0) << name;
    }
    EXPECT_EQ(iterations, (std::vector<int>{6, 15, 21}));
  }
}

TEST(KernelCheckOnGpu, ChangesNoByteIfTheTrainingIsDeterministic) {
  B3DGS_NEEDS_GPU();
  const Scene scene = test::make_tiny_scene();
  const test::TempDir temp;
  TrainConfig config = test::eventful_config();
  config.device = "cuda";
  config.deterministic = true;
  const test::Trained fixed = test::train(config, scene, temp / "fixed");
  config.kernel = kAdaptive;
  config.kernel_check_interval = 9;
  EXPECT_TRUE(test::same(test::train(config, scene, temp / "checked").ply, fixed.ply));
}

}  // namespace
}  // namespace b3dgs
