// Compares the exposure model with references in double precision.
#include "train/appearance/appearance_model.h"

#include <gtest/gtest.h>

#include "core/check.h"
#include "core/parallel.h"
#include "support/approx.h"
#include "support/train/appearance.h"

namespace b3dgs {
namespace {

using test::like;
using test::to_doubles;

constexpr int kPhotographs = 3;

AppearanceState random_exposures(const AppearanceModel& model) {
  AppearanceState state = model.make_state();
  state.exposures += 0.3 * torch::randn_like(state.exposures);
  return state;
}

/// Returns transform (r, g, b, 1) of each pixel, in double.
torch::Tensor exposed(const torch::Tensor& transform, const torch::Tensor& image) {
  const torch::Tensor matrix = transform.to(torch::kFloat64), color = image.to(torch::kFloat64);
  return torch::matmul(color, matrix.slice(1, 0, 3).t()) + matrix.select(1, 3);
}

TEST(ExposureModel, StartsWithTransformsThatChangeNothing) {
  torch::manual_seed(1);
  AppearanceModel model(TrainConfig{}, kPhotographs, torch::kCPU);
  const AppearanceState state = model.make_state();
  const torch::Tensor image = torch::randn({7, 5, 3});
  for (int view = 0; view < kPhotographs; ++view) EXPECT_TRUE(test::same(model.apply(state, view, image), image));
  const torch::Tensor grad = torch::randn({7, 5, 3}), before = grad.clone();
  model.backward(state, 1, image, grad);
  EXPECT_TRUE(test::same(grad, before));
}

TEST(ExposureModel, AppliesTheTransformOfTheView) {
  torch::manual_seed(2);
  AppearanceModel model(TrainConfig{}, kPhotographs, torch::kCPU);
  const AppearanceState state = random_exposures(model);
  for (const int height : {1, 40, 33}) {  // images of several sizes
    const torch::Tensor image = torch::rand({height, 70, 3});
    for (int view = 0; view < kPhotographs; ++view) {
      EXPECT_TRUE(test::within(model.apply(state, view, image), exposed(state.exposures[view], image), 1e-6));
    }
  }
  EXPECT_THROW(model.apply(state, kPhotographs, torch::rand({4, 4, 3})), LogicError);
}

TEST(ExposureModel, GradientsAreThoseOfFiniteDifferences) {
  torch::manual_seed(3);
  AppearanceModel model(TrainConfig{}, kPhotographs, torch::kCPU);
  const AppearanceState state = random_exposures(model);
  const torch::Tensor image = torch::rand({6, 5, 3}), weights = torch::randn({6, 5, 3});
  // This loss is not linear in the corrected colours.
  const auto loss = [&](const torch::Tensor& transform, const torch::Tensor& render) {
    return (weights.to(torch::kFloat64) * exposed(transform, render).sin()).sum().item<double>();
  };
  const torch::Tensor transform = state.exposures[1];
  const torch::Tensor grad = weights * model.apply(state, 1, image).cos();
  model.backward(state, 1, image, grad);
  const auto by_transform = test::numeric_gradient(
      [&](const std::vector<double>& x) { return loss(like(x, transform), image); }, to_doubles(transform));
  EXPECT_TRUE(test::gradients_agree(to_doubles(model.grad()), by_transform, 1e-5));
  const auto by_image = test::numeric_gradient(
      [&](const std::vector<double>& x) { return loss(transform, like(x, image)); }, to_doubles(image));
  EXPECT_TRUE(test::gradients_agree(to_doubles(grad), by_image, 1e-5));
}

TEST(ExposureModel, WhereThePhotographIsClippedABrighterRenderIsNoError) {
  torch::manual_seed(5);
  AppearanceModel model(TrainConfig{}, kPhotographs, torch::kCPU);
  const AppearanceState state = random_exposures(model);
  const torch::Tensor image = 2 * torch::rand({20, 19, 3}), from = torch::randn({20, 19, 3});
  torch::Tensor photograph = torch::randint(256, {20, 19, 3}, torch::kUInt8);
  photograph = photograph.where(torch::rand({20, 19, 3}) < 0.5, 253 + torch::randint(3, {20, 19, 3}, torch::kUInt8));
  const torch::Tensor plain = model.apply(state, 2, image).clone();
  const torch::Tensor most = photograph.to(torch::kFloat32) / 255;
  const torch::Tensor is_clipped = (photograph >= 254) & (plain > most);
  ASSERT_GT(is_clipped.sum().item<std::int64_t>(), 10);
  ASSERT_GT(((photograph == 253) & (plain > most)).sum().item<std::int64_t>(), 3) << "not clipped, brighter";
  ASSERT_GT(((photograph >= 254) & (plain < most)).sum().item<std::int64_t>(), 3) << "clipped, darker";

  model.set_photograph(photograph);
  EXPECT_TRUE(test::same(model.apply(state, 2, image), most.where(is_clipped, plain)));
  torch::Tensor grad = from.clone();
  model.backward(state, 2, image, grad);
  const torch::Tensor transform_grad = model.grad().clone();
  model.set_photograph({});
  torch::Tensor expected = from.masked_fill(is_clipped, 0);
  model.backward(state, 2, image, expected);
  EXPECT_TRUE(test::same(grad, expected));
  EXPECT_TRUE(test::same(transform_grad, model.grad()));
  model.set_photograph(photograph.to(torch::kFloat32));
  EXPECT_THROW(model.apply(state, 2, image), LogicError);
}

TEST(ExposureModel, GradientOfALargeImageIsExactOnAnyNumberOfThreads) {
  torch::manual_seed(4);
  AppearanceModel model(TrainConfig{}, kPhotographs, torch::kCPU);
  const AppearanceState state = random_exposures(model);
  const torch::Tensor image = torch::rand({150, 101, 3}), from = torch::randn({150, 101, 3});  // several blocks
  const torch::Tensor flat = from.to(torch::kFloat64).view({-1, 3});
  const torch::Tensor ones = torch::ones({flat.size(0), 1}, torch::kFloat64);
  const torch::Tensor expected =
      torch::matmul(flat.t(), torch::cat({image.to(torch::kFloat64).view({-1, 3}), ones}, 1));
  torch::Tensor first;
  const int threads = thread_count();
  for (const int n : {1, 2, 3}) {
    set_thread_count(n);
    model.backward(state, 0, image, from.clone());
    EXPECT_TRUE(test::within(model.grad(), expected, 1e-5 * expected.abs() + 1e-6));
    if (!first.defined()) first = model.grad().clone();
    EXPECT_TRUE(test::same(model.grad(), first)) << n << " threads";
  }
  set_thread_count(threads);
}

TEST(ExposureModel, StepsAreThoseOfAdamOnAllTransformsWhoseMeanStaysTheIdentity) {
  torch::manual_seed(5);
  TrainConfig config;
  config.iterations = 12;
  config.exposure_lr_init = 0.02;
  config.exposure_lr_final = 0.002;
  AppearanceModel model(config, kPhotographs, torch::kCPU);
  AppearanceState state = model.make_state();
  torch::Tensor expected = state.exposures.to(torch::kFloat64), m = torch::zeros_like(expected),
                v = torch::zeros_like(expected);
  for (int t = 1; t <= config.iterations; ++t) {
    const int view = t * t % kPhotographs;
    const torch::Tensor image = torch::rand({5, 4, 3});
    model.backward(state, view, image, torch::randn({5, 4, 3}));
    torch::Tensor grad = torch::zeros_like(expected);
    grad[view] = model.grad().to(torch::kFloat64);
    model.step(view, t, state);
    m = 0.9 * m + 0.1 * grad;
    v = 0.999 * v + 0.001 * grad * grad;
    const double rate = 0.02 * std::pow(0.1, t / 12.0);
    expected -= rate * (m / (1 - std::pow(0.9, t))) / ((v / (1 - std::pow(0.999, t))).sqrt() + 1e-15);
    expected += torch::eye(3, 4, torch::kFloat64) - expected.mean(0);
    EXPECT_TRUE(test::within(state.exposures, expected, 1e-5)) << "step " << t;
  }
  EXPECT_EQ(state.steps, config.iterations);
  EXPECT_TRUE(test::within(state.m, m, 1e-5));
}

}  // namespace
}  // namespace b3dgs
