// Compares the gradient and the Adam rule of a step along several views on the CPU with independent computations in
// double precision.
#include <gtest/gtest.h>

#include <cmath>

#include "config/batch_steps.h"
#include "config/output_plan.h"
#include "core/parallel.h"
#include "support/approx.h"
#include "support/train/tiny_scene.h"
#include "train/optimizer/gaussian_optimizer.h"

namespace b3dgs {
namespace {

const AdamRates kRates{1e-3, 2e-3, 3e-3, 4e-3, 5e-3, 6e-3};

/// Returns Gaussians in front of all cameras, except for a fifth behind them, and one at index 1 that only the camera
/// at the side sees.
GaussianTensors some_gaussians() {
  constexpr std::int64_t kGaussians = 103;
  GaussianTensors g{torch::randn({kGaussians, 3}) * 0.7, torch::randn({kGaussians, 3}) * 0.3 - 2,
                    torch::randn({kGaussians, 4}),       torch::randn({kGaussians}),
                    torch::randn({kGaussians, 1, 3}),    torch::randn({kGaussians, 15, 3}) * 0.1};
  g.means.slice(0, 0, c10::nullopt, 5).slice(1, 2, 3) -= 100;
  g.means[1] = torch::tensor({5.0f, 0.0f, 0.0f});
  g.log_scales[1] = -3;
  return g;
}

struct BatchView3 {
  PinholeView view;
  torch::Tensor image_grad;
};

std::vector<BatchView3> some_views() {
  std::vector<BatchView3> views;
  for (const auto& [x, z] : {std::pair(0.0, -6.0), {0.3, -5.0}, {-0.2, -5.5}, {9.0, -3.0}}) {
    views.push_back({to_camera_view(test::look_at_origin(x, 0.1, z, 50, 40)), torch::randn({40, 50, 3}) * 1e-2});
  }
  return views;
}

RenderSettings settings_of(bool antialiasing) {
  RenderSettings settings;
  settings.sh_degree = 2;  // of 3
  settings.antialiasing = antialiasing;
  return settings;
}

GaussianTensors copy_of(const GaussianTensors& from) {
  GaussianTensors copy = from;
  for (std::size_t i = 0; i < from.all().size(); ++i) *copy.all()[i] = from.all()[i]->clone();
  return copy;
}

/// Takes one step from zero moments along the first `n_views` views.
AdamState step_along(std::size_t n_views, GaussianTensors& gaussians, const RenderSettings& settings,
                     const RegularizationWeights& weights = {}) {
  AdamState state = make_adam_state(gaussians);
  Rasterizer rasterizer(torch::kCPU);
  GaussianOptimizer optimizer(rasterizer);
  const std::vector<BatchView3> views = [] {
    torch::manual_seed(2);
    return some_views();
  }();
  for (std::size_t v = 0; v < n_views; ++v) {
    rasterizer.forward(gaussians, views[v].view, optimizer.begin_view(gaussians, state, settings));
    optimizer.make_room_for_view(gaussians);
    optimizer.backward_and_keep(views[v].view, settings, {views[v].image_grad, {}, {}}, gaussians, weights);
  }
  EXPECT_EQ(optimizer.n_kept_views(), static_cast<int>(n_views));
  optimizer.step_views(kRates, gaussians, state, nullptr);
  EXPECT_EQ(optimizer.n_kept_views(), 0);
  EXPECT_EQ(state.steps, static_cast<std::int64_t>(n_views));
  return state;
}

/// Returns the mean over views of the gradients of single views, summed in double.
std::vector<torch::Tensor> mean_gradients(std::size_t n_views, const GaussianTensors& gaussians,
                                          const RenderSettings& settings, torch::Tensor* n_seen = nullptr) {
  torch::manual_seed(2);
  const std::vector<BatchView3> views = some_views();
  Rasterizer rasterizer(torch::kCPU);
  std::vector<torch::Tensor> sums;
  for (const torch::Tensor* parameter : gaussians.all()) {
    sums.push_back(torch::zeros(parameter->sizes(), torch::kFloat64));
  }
  for (std::size_t v = 0; v < n_views; ++v) {
    rasterizer.forward(gaussians, views[v].view, settings);
    GaussianTensors grads;
    const ViewStatistics statistics = rasterizer.backward(gaussians, {views[v].image_grad, {}, {}}, grads);
    for (std::size_t i = 0; i < sums.size(); ++i) {
      sums[i] += grads.all()[i]->to(torch::kFloat64) / static_cast<double>(n_views);
    }
    if (n_seen != nullptr) *n_seen += (statistics.radii > 0).to(torch::kInt32);
  }
  return sums;
}

TEST(BatchStep, HasTheMeanOfTheGradientsOfItsViews) {
  torch::manual_seed(1);
  const GaussianTensors start = some_gaussians();
  for (const bool antialiasing : {false, true}) {
    for (const std::size_t n_views : {1, 2, 3, 4}) {
      SCOPED_TRACE(testing::Message() << n_views << " views, antialiasing " << antialiasing);
      GaussianTensors gaussians = copy_of(start);
      gaussians.filters = torch::rand({start.size()}) * 0.01;
      const auto expected = mean_gradients(n_views, gaussians, settings_of(antialiasing));
      const AdamState state = step_along(n_views, gaussians, settings_of(antialiasing));
      const double rest1 = 1 - std::pow(0.9, n_views);
      for (std::size_t i = 0; i < expected.size(); ++i) {
        const torch::Tensor found = state.m.all()[i]->to(torch::kFloat64) / rest1;
        EXPECT_GT(expected[i].abs().max().item<double>(), 1e-5);
        EXPECT_TRUE(test::within(found, expected[i], 1e-6 * expected[i].abs().max().item<double>() + 1e-12))
            << GaussianTensors::kNames[i];
      }
    }
  }
}

TEST(BatchStep, CountsAGaussianThatOneViewOrNoneSees) {
  torch::manual_seed(1);
  const GaussianTensors start = some_gaussians();
  torch::Tensor n_seen = torch::zeros({start.size()}, torch::kInt32);
  const auto expected = mean_gradients(4, start, settings_of(false), &n_seen);
  ASSERT_EQ(n_seen[0].item<int>(), 0);
  ASSERT_EQ(n_seen[1].item<int>(), 1) << "by the last view";
  GaussianTensors gaussians = copy_of(start);
  const AdamState state = step_along(4, gaussians, settings_of(false));
  EXPECT_EQ(state.m.means[0].abs().max().item<float>(), 0);
  EXPECT_EQ(state.m.shN[0].abs().max().item<float>(), 0);
  EXPECT_TRUE(test::same(gaussians.means[0], start.means[0]));
  const double rest1 = 1 - std::pow(0.9, 4);
  EXPECT_GT(expected[0][1].abs().max().item<double>(), 0);
  EXPECT_TRUE(test::within(state.m.means[1].to(torch::kFloat64) / rest1, expected[0][1],
                           1e-6 * expected[0][1].abs().max().item<double>()));
}

TEST(BatchStep, AddsTheRegularizationOfEachViewThatSeesTheGaussian) {
  torch::manual_seed(1);
  const GaussianTensors start = some_gaussians();
  GaussianTensors with = copy_of(start), without = copy_of(start);
  constexpr double kOpacity = 0.6, kScale = 0.3;
  const AdamState regular = step_along(3, with, settings_of(false), {kOpacity, kScale}),
                  plain = step_along(3, without, settings_of(false));
  // Each view adds the weight divided by its number of visible Gaussians to those Gaussians.
  torch::manual_seed(2);
  Rasterizer rasterizer(torch::kCPU);
  torch::Tensor share = torch::zeros({start.size()}, torch::kFloat64);
  const std::vector<BatchView3> views = some_views();
  for (std::size_t v = 0; v < 3; ++v) {
    rasterizer.forward(start, views[v].view, settings_of(false));
    GaussianTensors grads;
    const torch::Tensor seen =
        (rasterizer.backward(start, {views[v].image_grad, {}, {}}, grads).radii > 0).to(torch::kFloat64);
    share += seen / seen.sum() / 3;
  }
  const torch::Tensor opacity = torch::sigmoid(start.logit_opacities.to(torch::kFloat64));
  const double rest1 = 1 - std::pow(0.9, 3);
  EXPECT_TRUE(test::within(regular.m.logit_opacities - plain.m.logit_opacities,
                           rest1 * kOpacity * share * opacity * (1 - opacity), 1e-7));
  EXPECT_TRUE(test::within(regular.m.log_scales - plain.m.log_scales,
                           rest1 * kScale / 3 * share.unsqueeze(1) * start.log_scales.to(torch::kFloat64).exp(), 1e-7));
  EXPECT_TRUE(test::same(regular.m.means, plain.m.means));
}

TEST(BatchStep, FollowsThePublishedRule) {
  // Rates are multiplied by sqrt(n), epsilon is divided by sqrt(n), and betas are raised to the power of n. t counts
  // views, also after steps of other sizes.
  torch::manual_seed(3);
  GaussianTensors gaussians = some_gaussians();
  std::array<torch::Tensor, 6> param, m, v;
  for (std::size_t i = 0; i < 6; ++i) {
    param[i] = gaussians.all()[i]->to(torch::kFloat64);
    m[i] = torch::zeros_like(param[i]);
    v[i] = torch::zeros_like(param[i]);
  }
  AdamState state = make_adam_state(gaussians);
  double beta1_product = 1, beta2_product = 1;
  for (const int n : {4, 4, 3, 1, 2}) {
    GaussianTensors grads = some_gaussians();
    AdamRates rates = kRates;
    for (double& rate : rates) rate *= std::sqrt(n);
    adam_step(rates, grads, gaussians, state, n);
    const double beta1 = std::pow(0.9, n), beta2 = std::pow(0.999, n);
    beta1_product *= beta1;
    beta2_product *= beta2;
    for (std::size_t i = 0; i < 6; ++i) {
      const torch::Tensor g = grads.all()[i]->to(torch::kFloat64);
      m[i] = beta1 * m[i] + (1 - beta1) * g;
      v[i] = beta2 * v[i] + (1 - beta2) * g * g;
      param[i] -= std::sqrt(n) * kRates[i] * (m[i] / (1 - beta1_product)) /
                  ((v[i] / (1 - beta2_product)).sqrt() + 1e-15 / std::sqrt(n));
    }
  }
  EXPECT_EQ(state.steps, 14);
  for (std::size_t i = 0; i < 6; ++i) {
    EXPECT_TRUE(test::within(*gaussians.all()[i], param[i], 1e-6 * (1 + param[i].abs()))) << GaussianTensors::kNames[i];
    EXPECT_TRUE(test::within(*state.m.all()[i], m[i], 1e-6 * (1 + m[i].abs()))) << GaussianTensors::kNames[i];
  }
  // Epsilon matters where gradients are tiny.
  const AdamRule rule = adam_rule(4), one = adam_rule(1), same;
  EXPECT_FLOAT_EQ(rule.epsilon, 0.5e-15f);
  EXPECT_EQ(one.beta1, same.beta1);
  EXPECT_EQ(one.rest2, same.rest2);
  EXPECT_EQ(one.epsilon, same.epsilon);
}

TEST(BatchStep, DoesNotDependOnTheNumberOfThreads) {
  torch::manual_seed(4);
  const GaussianTensors start = some_gaussians();
  const int before = thread_count();
  std::vector<GaussianTensors> results;
  for (const int threads : {1, 3}) {
    set_thread_count(threads);
    results.push_back(copy_of(start));
    step_along(4, results.back(), settings_of(false), {0.1, 0.1});
  }
  set_thread_count(before);
  for (std::size_t i = 0; i < 6; ++i) EXPECT_TRUE(test::same(*results[0].all()[i], *results[1].all()[i]));
}

TEST(BatchStep, ForgetsViewsThatAreDropped) {
  torch::manual_seed(5);
  GaussianTensors gaussians = some_gaussians();
  AdamState state = make_adam_state(gaussians);
  Rasterizer rasterizer(torch::kCPU);
  GaussianOptimizer optimizer(rasterizer);
  const PinholeView view = some_views()[0].view;
  rasterizer.forward(gaussians, view, optimizer.begin_view(gaussians, state, settings_of(false)));
  optimizer.make_room_for_view(gaussians);
  optimizer.backward_and_keep(view, settings_of(false), {torch::ones({40, 50, 3}), {}, {}}, gaussians);
  optimizer.drop_views();
  EXPECT_EQ(optimizer.n_kept_views(), 0);
  EXPECT_GT(optimizer.kept_bytes(), 0) << "memory is kept for the next step";
  EXPECT_THROW(optimizer.step_views(kRates, gaussians, state, nullptr), LogicError);
}

TEST(BatchSteps, EndAtMultiplesAndAtTheLastIteration) {
  EXPECT_EQ(step_end(1, 10, 0), 1);
  EXPECT_EQ(step_end(4, 10, 0), 4);
  EXPECT_EQ(step_end(4, 10, 4), 8);
  EXPECT_EQ(step_end(4, 10, 8), 10) << "fewer";
  EXPECT_EQ(step_end(4, 10, 5), 8) << "resumed within a step of an uninterrupted training";
  EXPECT_EQ(step_end(4, 10, 10), 11) << "always goes on";
}

TEST(BatchSteps, DoWhatFallsOnAnyOfTheirIterations) {
  TrainConfig config;
  config.iterations = 30;
  config.save_iterations = {6};
  config.test_iterations = {7};
  config.checkpoint_interval = 9;
  config.stats_interval = 0;
  const OutputPlan first = output_plan(config, 5, 8, true), second = output_plan(config, 9, 12, true),
                   last = output_plan(config, 29, 30, true);
  EXPECT_TRUE(first.save && first.evaluate && first.log);
  EXPECT_FALSE(first.checkpoint);
  EXPECT_TRUE(second.checkpoint && second.log);
  EXPECT_FALSE(second.save || second.evaluate);
  EXPECT_TRUE(last.save && last.evaluate && last.checkpoint && last.log);
}

}  // namespace
}  // namespace b3dgs
