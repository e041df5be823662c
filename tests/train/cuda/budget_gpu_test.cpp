// Compares strategy budget on the GPU with that on the CPU.
#include <gtest/gtest.h>

#include "core/config.h"
#include "support/approx.h"
#include "support/gpu_test.h"
#include "support/same.h"
#include "support/temp_dir.h"
#include "support/train/tiny_scene.h"
#include "support/train/training.h"
#include "train/density/strategies/strategies.h"
#include "train/loss/loss.h"

namespace b3dgs {
namespace {

using test::train;
using test::Trained;

TEST(BudgetOnGpu, PlansTheRoundThatTheCpuPlans) {
  B3DGS_NEEDS_GPU();
  torch::manual_seed(4);
  constexpr std::int64_t kCount = 5000;
  constexpr int kPruneRound = 3000;
  const GaussianTensors host{torch::randn({kCount, 3}),  torch::randn({kCount, 3}) - 2, torch::randn({kCount, 4}),
                             torch::randn({kCount}) * 3, torch::randn({kCount, 1, 3}),  torch::randn({kCount, 3, 3})};
  TrainConfig config;
  config.strategy = Strategy::kBudget;
  config.max_gaussians = 9000;
  config.densification_interval = 500;
  const std::unique_ptr<DensityStrategy> strategy = make_budget_strategy(config, 1);
  DensityStatistics seen = strategy->make_statistics(kCount, torch::kCPU);
  for (DensityStatistics::Column& column : seen.extra) column.values = torch::rand({kCount}) * 2;
  seen.extra[2].values *= 20;  // scored views
  seen.extra[1].values *= 0.02;
  GaussianTensors device;
  for (std::size_t i = 0; i < host.all().size(); ++i) *device.all()[i] = host.all()[i]->to(torch::kCUDA);
  DensityStatistics device_seen = strategy->make_statistics(kCount, torch::Device(torch::kCUDA, 0));
  for (std::size_t i = 0; i < seen.all().size(); ++i) *device_seen.all()[i] = seen.all()[i]->to(torch::kCUDA);
  const DensityRound expected = strategy->plan_round(host, seen, kPruneRound, 0),
                     found = strategy->plan_round(device, device_seen, kPruneRound, 0);
  EXPECT_GT(expected.n_split, 200);
  EXPECT_GT(expected.n_pruned, 200);
  // Keys may be rounded to the next float, which can decide which of two Gaussians with nearly equal keys is drawn.
  EXPECT_EQ(found.n_split, expected.n_split);
  EXPECT_EQ(found.n_pruned, expected.n_pruned);
  ASSERT_EQ(found.edit.n_kept, expected.edit.n_kept);
  const torch::Tensor is_same = found.edit.sources.to(torch::kCPU) == expected.edit.sources;
  EXPECT_GE(is_same.sum().item<std::int64_t>(), is_same.numel() * 9 / 10);
  const torch::Tensor new_is_same = is_same.slice(0, found.edit.n_kept).to(torch::kFloat32);
  const torch::Tensor means = found.edit.new_means.to(torch::kCPU);
  const torch::Tensor allowed = 1e-6 * (1 + expected.edit.new_means.abs());
  EXPECT_TRUE(
      test::within(means * new_is_same.unsqueeze(1), expected.edit.new_means * new_is_same.unsqueeze(1), allowed));
  EXPECT_TRUE(test::within(found.edit.new_log_scales.to(torch::kCPU) * new_is_same.unsqueeze(1),
                           expected.edit.new_log_scales * new_is_same.unsqueeze(1), 1e-5));
  EXPECT_TRUE(test::within(found.edit.new_logit_opacities.to(torch::kCPU) * new_is_same,
                           expected.edit.new_logit_opacities * new_is_same, 1e-5));
}

TEST(BudgetOnGpu, ErrorImageIsThatOfTheCpu) {
  B3DGS_NEEDS_GPU();
  torch::manual_seed(5);
  const torch::Tensor rendered = torch::randn({33, 47, 3}), truth = torch::randint(256, {33, 47, 3}, torch::kUInt8),
                      valid = torch::randint(2, {33, 47}, torch::kUInt8);
  ErrorImage host, device;
  host.compute(rendered, truth, valid);
  device.compute(rendered.to(torch::kCUDA), truth.to(torch::kCUDA), valid.to(torch::kCUDA));
  EXPECT_TRUE(test::within(device.error().to(torch::kCPU), host.error(), 1e-5));
}

TEST(BudgetOnGpu, LearnsAsOnTheCpu) {
  B3DGS_NEEDS_GPU();
  const Scene scene = test::make_tiny_scene(test::learnable_scene());
  const test::TempDir temp;
  TrainConfig config = test::growing_budget_config(400, 350);
  const Trained cpu = train(config, scene, temp / "cpu");
  for (const char* kernel : {"sub-tile", "combined"}) {
    config.device = "cuda";
    config.kernel = kernel;
    const Trained gpu = train(config, scene, temp / kernel);
    EXPECT_NEAR(gpu.result.evaluations.back().second.mean.psnr, cpu.result.evaluations.back().second.mean.psnr, 0.5);
    EXPECT_NEAR(static_cast<double>(gpu.result.n_gaussians), static_cast<double>(cpu.result.n_gaussians), 10);
  }
}

}  // namespace
}  // namespace b3dgs
