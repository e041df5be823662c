// Kernel checks on the GPU: both passes, timed by the device.
#include <gtest/gtest.h>

#include <fstream>

#include "core/check.h"
#include "support/gpu_test.h"
#include "support/temp_dir.h"
#include "support/train/tiny_scene.h"
#include "support/train/training.h"
#include "train/selection/kernel_chooser.h"

namespace b3dgs {
namespace {

TrainConfig measured_config() {
  TrainConfig config = test::eventful_config();
  config.device = "cuda";
  config.kernel = config.backward_kernel = "adaptive";
  config.kernel_policy = "tracking";
  config.kernel_candidates.clear();
  for (const ForwardKernelName& kernel : kForwardKernels) config.kernel_candidates.emplace_back(kernel.name);
  config.kernel_check_interval = 3;
  config.stats_interval = 5;
  return config;
}

TEST(RunTimerOnGpu, GivesTheTimeOfEachRunInOrder) {
  B3DGS_NEEDS_GPU();
  constexpr std::int64_t kBytes = 256 << 20;
  const torch::Device device(torch::kCUDA, 0);
  const torch::Tensor memory = torch::empty({kBytes}, torch::TensorOptions(torch::kUInt8).device(device));
  const RunTimer time_runs = make_run_timer(device);
  const auto large = [&] { memory.zero_(); };
  const auto small = [&] { memory.slice(0, 0, 16).zero_(); };
  time_runs({large});  // warm-up: first uses are slow
  EXPECT_TRUE(time_runs({}).empty());
  for (int round = 0; round < 3; ++round) {
    const std::vector<double> ms = time_runs({large, small, large});
    ASSERT_EQ(ms.size(), 3u);
    EXPECT_GT(ms[0], ms[1]) << "the first run has 16 million times the work";
    EXPECT_GT(ms[2], ms[1]);
    EXPECT_GT(ms[1], 0);
  }
}

TEST(KernelChooserOnGpu, EveryKernelAgreesWithTheReferenceAndIsTimed) {
  B3DGS_NEEDS_GPU();
  const torch::Device device(torch::kCUDA, 0);
  test::TinySceneOptions options;
  options.width = 400;
  options.height = 300;
  const Scene scene = test::make_tiny_scene(options);
  const GaussianTensors gaussians = to_tensors(splats_from_points(scene.points, 0), 0, device);
  std::vector<CameraView> cameras;
  for (const View& view : scene.train) cameras.push_back(to_camera_view(view.camera));
  Rasterizer rasterizer(device);
  KernelChooser chooser(measured_config(), device);
  const auto render = [&](const CameraView& view, const RenderSettings& settings) {
    return rasterizer.forward(gaussians, view, settings);
  };
  const std::vector<KernelDecision> done = chooser.check({1, 0}, {rasterizer, render, {}, cameras});
  ASSERT_EQ(done.size(), 2u);
  EXPECT_EQ(done[0].pass, "forward");
  EXPECT_EQ(done[1].pass, "backward");
  EXPECT_EQ(done[0].times_ms.size(), kForwardKernels.size());
  EXPECT_EQ(done[1].times_ms.size(), kBackwardKernels.size());
  for (const KernelDecision& check : done) {
    EXPECT_TRUE(check.disabled.empty()) << check.reason;
    EXPECT_GE(check.views, KernelSelector::kMinViews);
    for (const auto& [kernel, ms] : check.times_ms) EXPECT_GT(ms, 0) << kernel;
  }
}

TEST(RasterizerOnGpu, ReblendBackwardRejectsAGradientOfAnotherShapeAsBackwardDoes) {
  B3DGS_NEEDS_GPU();
  const torch::Device device(torch::kCUDA, 0);
  const Scene scene = test::make_tiny_scene();
  const GaussianTensors gaussians = to_tensors(splats_from_points(scene.points, 0), 0, device);
  Rasterizer rasterizer(device);
  const torch::Tensor color = rasterizer.forward(gaussians, to_camera_view(scene.train[0].camera), {}).color;
  RenderedViewGrad grad;
  grad.color = torch::zeros_like(color).narrow(0, 0, 1);
  EXPECT_THROW(rasterizer.reblend_backward(BackwardKernel::kPerBucket, grad), LogicError);
  grad.color = torch::zeros_like(color).cpu();
  EXPECT_THROW(rasterizer.reblend_backward(BackwardKernel::kPerBucket, grad), LogicError);
  grad.color = torch::zeros_like(color);
  EXPECT_NO_THROW(rasterizer.reblend_backward(BackwardKernel::kPerBucket, grad));
}

TEST(KernelChooserOnGpu, LogsItsChecksAndTrainingContinues) {
  B3DGS_NEEDS_GPU();
  const Scene scene = test::make_tiny_scene();
  const test::TempDir temp;
  const test::Trained run = test::train(measured_config(), scene, temp.path(), {}, test::slow_training());
  EXPECT_EQ(run.result.iteration, 20);
  std::ifstream file(temp / "train.jsonl");
  int n_forward = 0, n_backward = 0, n_loads = 0;
  for (std::string line; std::getline(file, line);) {
    const nlohmann::json json = nlohmann::json::parse(line);
    const std::string event = json.value("event", "");
    if (event == "kernel_check") ++(json.at("pass") == "forward" ? n_forward : n_backward);
    if (event == "load_statistics") ++n_loads;
    if (!event.empty()) continue;
    EXPECT_TRUE(find_kernel(kBackwardKernels, json.at("backward_kernel").get<std::string>())) << line;
  }
  EXPECT_GE(n_forward, 3);
  EXPECT_GE(n_backward, 3);
  EXPECT_EQ(n_loads, 5);
}

}  // namespace
}  // namespace b3dgs
