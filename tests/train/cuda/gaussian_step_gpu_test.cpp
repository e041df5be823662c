// Compares the fused optimizer step on the GPU with its two halves (stored gradients, and Adam on the CPU), and
// deferred updates with immediate ones.
#include "train/optimizer/gaussian_optimizer.h"

#include <gtest/gtest.h>

#include "support/approx.h"
#include "support/gpu_test.h"
#include "support/train/tiny_scene.h"

namespace b3dgs {
namespace {

const torch::Device kGpu(torch::kCUDA, 0);

GaussianTensors copy_to(const GaussianTensors& from, torch::Device device) {
  GaussianTensors copy;
  for (std::size_t i = 0; i < from.all().size(); ++i) *copy.all()[i] = from.all()[i]->clone().to(device);
  return copy;
}

AdamState copy_to(const AdamState& from, torch::Device device) {
  return {copy_to(from.m, device), copy_to(from.v, device), from.steps, {}};
}

/// Returns moments as in the middle of a training, which are nonzero for all degrees that are optimised so far.
AdamState used_moments(const GaussianTensors& gaussians, int sh_degree) {
  AdamState state = make_adam_state(gaussians);
  state.steps = 41;
  for (torch::Tensor* m : state.m.all()) m->normal_(0, 1e-3);
  for (torch::Tensor* v : state.v.all()) v->uniform_(0, 1e-6);
  const std::int64_t learned = (sh_degree + 1) * (sh_degree + 1) - 1;
  for (GaussianTensors* moments : {&state.m, &state.v}) moments->shN.slice(1, learned).zero_();
  return state;
}

/// Returns Gaussians of which 4 of 5 are visible and the others are behind the camera. Their number is not a multiple
/// of the block size.
GaussianTensors some_gaussians(int sh_degree_max) {
  constexpr std::int64_t kGaussians = 1003;
  const std::int64_t n_rest = (sh_degree_max + 1) * (sh_degree_max + 1) - 1;
  GaussianTensors g{torch::randn({kGaussians, 3}),          torch::randn({kGaussians, 3}) * 0.3 - 2,
                    torch::randn({kGaussians, 4}),          torch::randn({kGaussians}),
                    torch::randn({kGaussians, 1, 3}) * 0.5, torch::randn({kGaussians, n_rest, 3}) * 0.1};
  g.means.slice(0, 0, c10::nullopt, 5).slice(1, 2, 3) -= 100;
  return g;
}

PinholeView view_from(double x, double z) {
  return to_camera_view(test::look_at_origin(x, 0, z, 90, 70));
}

RenderSettings settings_of(int sh_degree) {
  RenderSettings settings;
  settings.sh_degree = sh_degree;
  settings.deterministic = true;  // for the same render and sums
  return settings;
}

const AdamRates kRates{1e-3, 2e-3, 3e-3, 4e-3, 5e-3, 6e-3};

class GaussianStepOnGpu : public testing::TestWithParam<std::pair<int, int>> {};

TEST_P(GaussianStepOnGpu, EqualsGradientsFollowedByAdam) {
  B3DGS_NEEDS_GPU();
  torch::manual_seed(5);
  const auto [sh_degree, sh_degree_max] = GetParam();
  const GaussianTensors start = some_gaussians(sh_degree_max);
  const AdamState moments = used_moments(start, sh_degree);
  const PinholeView view = view_from(0, -6);
  const RenderSettings settings = settings_of(sh_degree);
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
  adam_step(kRates, copy_to(grads, torch::kCPU), expected, expected_state);

  GaussianOptimizer optimizer(rasterizer);
  const torch::Tensor color = image.color.clone();
  const RenderSettings begun = optimizer.begin_view(stepped, stepped_state, settings);
  EXPECT_TRUE(test::same(rasterizer.forward(stepped, view, begun).color, color));
  statistics = optimizer.backward_and_step(kRates, view_grad, stepped, stepped_state, nullptr);
  optimizer.flush(stepped, stepped_state);
  EXPECT_EQ(stepped_state.steps, 42);
  EXPECT_TRUE(
      test::within(statistics.means2d_grad.cpu(), means2d_grad, 1e-6 * means2d_grad.abs().max().item<double>()));
  EXPECT_TRUE(test::same(statistics.radii.cpu(), radii));
  // Gradients of the two kernels differ by relative rounding errors up to kRounding, and their squares by twice that.
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
    // A parameter is rounded relative to its own size, which is larger than the change.
    EXPECT_TRUE(test::within(move, wanted, 2 * kRounding * (wanted.abs() + kRates[i]) + 2e-7 * before.abs())) << name;
  }
}

/// Returns whether everything that a step changes is bit-identical.
testing::AssertionResult is_equal(const GaussianTensors& a, const AdamState& a_state, const GaussianTensors& b,
                                  const AdamState& b_state) {
  for (std::size_t i = 0; i < a.all().size(); ++i) {
    const char* const name = GaussianTensors::kNames[i];
    if (!torch::equal(*a.all()[i], *b.all()[i])) return testing::AssertionFailure() << name;
    if (!torch::equal(*a_state.m.all()[i], *b_state.m.all()[i])) return testing::AssertionFailure() << "m of " << name;
    if (!torch::equal(*a_state.v.all()[i], *b_state.v.all()[i])) return testing::AssertionFailure() << "v of " << name;
  }
  if (a_state.directions.defined() && !torch::equal(a_state.directions, b_state.directions)) {
    return testing::AssertionFailure() << "directions";
  }
  return testing::AssertionSuccess();
}

TEST(RegularizationOnGpu, EqualsThatOnTheCpu) {
  B3DGS_NEEDS_GPU();
  torch::manual_seed(8);
  const GaussianTensors start = some_gaussians(3);
  const auto moments_on = [&](torch::Device device) {
    GaussianTensors gaussians = copy_to(start, device);
    AdamState state = make_adam_state(gaussians);
    Rasterizer rasterizer(device);
    GaussianOptimizer optimizer(rasterizer);
    const RenderedView image =
        rasterizer.forward(gaussians, view_from(0, -6), optimizer.begin_view(gaussians, state, settings_of(3)));
    const ViewStatistics statistics = optimizer.backward_and_step(
        kRates, {torch::zeros_like(image.color), {}, {}}, gaussians, state, nullptr, RegularizationWeights{0.4, 0.9});
    optimizer.flush(gaussians, state);
    EXPECT_GT((statistics.radii == 0).sum().item<int>(), 150);
    return copy_to(state.m, torch::kCPU);
  };
  const GaussianTensors expected = moments_on(torch::kCPU), found = moments_on(kGpu);
  EXPECT_TRUE(test::within(found.logit_opacities, expected.logit_opacities, 1e-5 * expected.logit_opacities.abs()));
  EXPECT_TRUE(test::within(found.log_scales, expected.log_scales, 1e-5 * expected.log_scales.abs()));
  EXPECT_GT(expected.log_scales.min().item<float>(), -1e-30f);
  EXPECT_GT(expected.log_scales.max().item<float>(), 0);
  EXPECT_EQ(found.means.abs().max().item<float>(), 0);
}

TEST(ShDecayOnGpu, EqualsThatOnTheCpu) {
  B3DGS_NEEDS_GPU();
  torch::manual_seed(9);
  const GaussianTensors start = some_gaussians(3);
  const torch::Tensor image_grad = torch::randn({70, 90, 3}) * 1e-3;
  struct Result {
    torch::Tensor with, without, directions;
  };
  const auto steps_on = [&](torch::Device device, bool as_batch) {
    Result result;
    for (const double strength : {0.0, 0.03}) {
      GaussianTensors gaussians = copy_to(start, device);
      AdamState state = make_adam_state(gaussians);
      Rasterizer rasterizer(device);
      GaussianOptimizer optimizer(rasterizer, strength);
      const RenderedViewGrad grad{image_grad.to(device), {}, {}};
      for (int k = 0; k < 12; ++k) {
        const PinholeView view = view_from(0.4 * (k % 5 - 2), -6);
        rasterizer.forward(gaussians, view, optimizer.begin_view(gaussians, state, settings_of(3)));
        if (!as_batch) {
          optimizer.backward_and_step(kRates, grad, gaussians, state, nullptr);
          continue;
        }
        optimizer.make_room_for_view(gaussians);
        optimizer.backward_and_keep(view, settings_of(3), grad, gaussians);
        if (k % 3 == 2) optimizer.step_views(kRates, gaussians, state, nullptr);
      }
      optimizer.flush(gaussians, state);
      (strength > 0 ? result.with : result.without) = gaussians.shN.cpu();
      if (strength > 0) result.directions = state.directions.cpu();
    }
    return result;
  };
  for (const bool as_batch : {false, true}) {
    const Result expected = steps_on(torch::kCPU, as_batch), found = steps_on(kGpu, as_batch);
    EXPECT_TRUE(test::within(found.directions, expected.directions, 1e-4));
    EXPECT_GT((expected.directions.select(1, 3) > 8).sum().item<int>(), 500) << "beyond the limit for few views";
    // The effect of the decay. The steps themselves differ where a gradient is near 0.
    const torch::Tensor effect = expected.with - expected.without;
    EXPECT_GT(effect.abs().max().item<double>(), 1e-2);
    const torch::Tensor error = ((found.with - found.without) - effect).abs();
    EXPECT_LT(error.mean().item<double>(), 0.02 * effect.abs().mean().item<double>());
  }
}

TEST(DeferredSh, UpdatesGiveTheSameBitsWheneverTheyAreFlushed) {
  B3DGS_NEEDS_GPU();
  torch::manual_seed(6);
  // Takes more steps than can be deferred at once. Views from the side, in an irregular order, leave many Gaussians
  // outside the frustum, and the SH degree rises meanwhile.
  constexpr int kSteps = 150;
  GaussianTensors often = copy_to(some_gaussians(3), kGpu), rarely = copy_to(often, kGpu), late = copy_to(often, kGpu);
  AdamState often_state = make_adam_state(often), rarely_state = make_adam_state(often),
            late_state = make_adam_state(often);
  const torch::Tensor start = often.shN.clone();
  Rasterizer rasterizer(kGpu);
  constexpr double kShDecay = 0.03;
  GaussianOptimizer often_optimizer(rasterizer, kShDecay), rarely_optimizer(rasterizer, kShDecay),
      late_optimizer(rasterizer, kShDecay);
  const torch::Tensor image_grad = torch::randn({70, 90, 3}).to(kGpu) * 1e-3;
  torch::Tensor n_seen = torch::zeros({often.size()});
  for (int k = 0; k < kSteps; ++k) {
    const PinholeView view = view_from(0.7 * (k * k % 7 - 3), k % 5 == 0 ? -2.5 : -1.2);
    const RenderSettings settings = settings_of(std::min(k / 20, 3));
    const auto step = [&](GaussianOptimizer& optimizer, GaussianTensors& gaussians, AdamState& state) {
      rasterizer.forward(gaussians, view, optimizer.begin_view(gaussians, state, settings));
      if (k % 11 == 5 && &optimizer == &rarely_optimizer)
        optimizer.flush(gaussians, state);  // including Gaussians that are visible in the current view
      return optimizer.backward_and_step(kRates, {image_grad, {}, {}}, gaussians, state, nullptr);
    };
    step(late_optimizer, late, late_state);
    step(rarely_optimizer, rarely, rarely_state);
    const ViewStatistics statistics = step(often_optimizer, often, often_state);
    n_seen += (statistics.radii > 0).cpu().to(torch::kFloat32);
    often_optimizer.flush(often, often_state);
    if (k % 37 == 0) {
      rarely_optimizer.flush(rarely, rarely_state);
      ASSERT_TRUE(is_equal(rarely, rarely_state, often, often_state)) << "after step " << k;
    }
  }
  EXPECT_FALSE(torch::equal(late.shN, often.shN)) << "nothing was deferred";
  late_optimizer.flush(late, late_state);
  EXPECT_TRUE(is_equal(late, late_state, often, often_state));
  EXPECT_GT((n_seen == 0).sum().item<int>(), 100) << "never seen";
  EXPECT_GT(((n_seen > 0).logical_and(n_seen < kSteps / 2)).sum().item<int>(), 100) << "seen in some views";
  EXPECT_GT((often.shN - start).abs().max().item<double>(), 0.1) << "SH coefficients moved";
}

TEST(DeferredSh, RejectsOtherTensorsWhileUpdatesAreDeferred) {
  B3DGS_NEEDS_GPU();
  torch::manual_seed(7);
  GaussianTensors gaussians = copy_to(some_gaussians(2), kGpu);
  AdamState state = make_adam_state(gaussians);
  Rasterizer rasterizer(kGpu);
  GaussianOptimizer optimizer(rasterizer);
  const torch::Tensor image_grad = torch::randn({70, 90, 3}).to(kGpu);
  const auto step = [&] {
    rasterizer.forward(gaussians, view_from(0, -6), optimizer.begin_view(gaussians, state, settings_of(2)));
    optimizer.backward_and_step(kRates, {image_grad, {}, {}}, gaussians, state, nullptr);
  };
  step();
  state.m.shN = state.m.shN.clone();
  EXPECT_THROW(step(), LogicError);
  EXPECT_THROW(optimizer.flush(gaussians, state), LogicError);
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
