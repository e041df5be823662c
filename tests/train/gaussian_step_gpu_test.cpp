// The fused step on the GPU against its two halves: gradients that are stored, and Adam on the CPU.
#include "train/gaussian_step.h"

#include <gtest/gtest.h>

#include "support/approx.h"
#include "support/gpu_test.h"
#include "train/tiny_scene.h"

namespace b3dgs {
namespace {

const torch::Device kGpu(torch::kCUDA, 0);

GaussianTensors copy_to(const GaussianTensors& from, torch::Device device) {
  GaussianTensors copy;
  for (std::size_t i = 0; i < from.all().size(); ++i) *copy.all()[i] = from.all()[i]->clone().to(device);
  return copy;
}

AdamState copy_to(const AdamState& from, torch::Device device) {
  return {copy_to(from.m, device), copy_to(from.v, device), from.steps};
}

/// Moments of a training under way: of all degrees that are learned by now.
AdamState used_moments(const GaussianTensors& gaussians, int sh_degree) {
  AdamState state = make_adam_state(gaussians);
  state.steps = 41;
  for (torch::Tensor* m : state.m.all()) m->normal_(0, 1e-3);
  for (torch::Tensor* v : state.v.all()) v->uniform_(0, 1e-6);
  const std::int64_t learned = (sh_degree + 1) * (sh_degree + 1) - 1;
  for (GaussianTensors* moments : {&state.m, &state.v}) moments->shN.slice(1, learned).zero_();
  return state;
}

/// 4 of every 5 in view, the others behind the camera; not a whole number of blocks.
GaussianTensors some_gaussians(int sh_degree_max) {
  constexpr std::int64_t kGaussians = 1003;
  const std::int64_t n_rest = (sh_degree_max + 1) * (sh_degree_max + 1) - 1;
  GaussianTensors g{torch::randn({kGaussians, 3}),          torch::randn({kGaussians, 3}) * 0.3 - 2,
                    torch::randn({kGaussians, 4}),          torch::randn({kGaussians}),
                    torch::randn({kGaussians, 1, 3}) * 0.5, torch::randn({kGaussians, n_rest, 3}) * 0.1};
  g.means.slice(0, 0, c10::nullopt, 5).slice(1, 2, 3) -= 100;
  return g;
}

class GaussianStepOnGpu : public testing::TestWithParam<std::pair<int, int>> {};

TEST_P(GaussianStepOnGpu, IsTheGradientsAndThenAdam) {
  B3DGS_NEEDS_GPU();
  torch::manual_seed(5);
  const auto [sh_degree, sh_degree_max] = GetParam();
  const GaussianTensors start = some_gaussians(sh_degree_max);
  const AdamState moments = used_moments(start, sh_degree);
  const PinholeView view = to_pinhole_view(test::look_at_origin(0, 0, -6, 90, 70));
  const AdamRates rates{1e-3, 2e-3, 3e-3, 4e-3, 5e-3, 6e-3};
  RenderSettings settings;
  settings.sh_degree = sh_degree;
  settings.tile = {16, 8};
  settings.deterministic = true;  // both get the same sums
  Rasterizer rasterizer(kGpu);

  GaussianTensors stepped = copy_to(start, kGpu);
  AdamState stepped_state = copy_to(moments, kGpu);
  const RenderedView image = rasterizer.forward(stepped, view, settings);
  const RenderedViewGrad view_grad{torch::randn(image.color.sizes()).to(kGpu) * 1e-3, {}, {}};
  GaussianTensors grads;
  ViewStatistics statistics = rasterizer.backward(stepped, view_grad, grads);
  const torch::Tensor means2d_grad = statistics.means2d_grad.cpu(), radii = statistics.radii.cpu();
  ASSERT_GT((radii == 0).sum().item<int>(), 150);
  ASSERT_GT((radii > 0).sum().item<int>(), 500);

  GaussianTensors expected = copy_to(start, torch::kCPU);
  AdamState expected_state = copy_to(moments, torch::kCPU);
  adam_step(rates, copy_to(grads, torch::kCPU), expected, expected_state);

  rasterizer.forward(stepped, view, settings);
  GaussianTensors unused;
  statistics = step_gaussians({rates, nullptr}, rasterizer, view_grad, unused, stepped, stepped_state);
  EXPECT_EQ(stepped_state.steps, 42);
  EXPECT_FALSE(unused.means.defined()) << "gradients are not stored";
  EXPECT_TRUE(
      test::within(statistics.means2d_grad.cpu(), means2d_grad, 1e-6 * means2d_grad.abs().max().item<double>()));
  EXPECT_TRUE(torch::equal(statistics.radii.cpu(), radii));
  // Two kernels' gradients differ in rounding, by up to kRounding of their size; a square by twice that.
  constexpr double kRounding = 1e-5;
  const auto agrees = [](const torch::Tensor& actual, const torch::Tensor& wanted, double allowed) {
    return test::within(actual.cpu(), wanted, allowed * (wanted.numel() > 0 ? wanted.abs().max().item<double>() : 0));
  };
  for (std::size_t i = 0; i < expected.all().size(); ++i) {
    const char* const name = GaussianTensors::kNames[i];
    EXPECT_TRUE(agrees(*stepped_state.m.all()[i], *expected_state.m.all()[i], kRounding)) << name;
    EXPECT_TRUE(agrees(*stepped_state.v.all()[i], *expected_state.v.all()[i], 2 * kRounding)) << name;
    const torch::Tensor& before = *start.all()[i];
    const torch::Tensor move = stepped.all()[i]->cpu() - before, wanted = *expected.all()[i] - before;
    // What is stored is rounded to its own size, which is larger than the move.
    EXPECT_TRUE(test::within(move, wanted, 2 * kRounding * (wanted.abs() + rates[i]) + 2e-7 * before.abs())) << name;
  }
}

INSTANTIATE_TEST_SUITE_P(ByDegree, GaussianStepOnGpu,
                         testing::Values(std::pair(0, 0), std::pair(0, 3), std::pair(1, 3), std::pair(2, 3),
                                         std::pair(3, 3), std::pair(1, 1), std::pair(2, 2)),
                         [](const auto& info) {
                           return "Learned" + std::to_string(info.param.first) + "Of" +
                                  std::to_string(info.param.second);
                         });

}  // namespace
}  // namespace b3dgs
