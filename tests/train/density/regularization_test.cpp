// Tests the gradients of the opacity and scale regularisation.

#include "train/optimizer/adam_args.h"

#include <gtest/gtest.h>

#include <cmath>
#include <vector>

#include "support/approx.h"
#include "support/finite_difference.h"
#include "support/train/tiny_scene.h"
#include "train/optimizer/gaussian_optimizer.h"

namespace b3dgs {
namespace {

/// Returns some Gaussians, of which the first three are behind the camera of tiny_view().
GaussianTensors some_gaussians() {
  torch::manual_seed(2);
  GaussianTensors g{torch::randn({12, 3}) * 0.3, torch::randn({12, 3}) * 0.3 - 2, torch::randn({12, 4}),
                    torch::randn({12}) * 2,      torch::randn({12, 1, 3}),        torch::randn({12, 3, 3})};
  g.means.slice(0, 0, 3).select(1, 2).sub_(50);
  return g;
}

PinholeView tiny_view() {
  return to_camera_view(test::look_at_origin(0, 0, -3, 40, 30));
}

/// Returns the regularisation of the Gaussians with a positive radius, in double. `x` contains logits [N] and log
/// scales [N, 3] in one vector.
double regularization(const RegularizationWeights& weights, const torch::Tensor& radii, const std::vector<double>& x) {
  const std::int64_t n = radii.size(0);
  double opacities = 0, scales = 0, n_seen = 0;
  for (std::int64_t i = 0; i < n; ++i) {
    if (radii[i].item<int>() <= 0) continue;
    ++n_seen;
    opacities += 1 / (1 + std::exp(-x[static_cast<std::size_t>(i)]));
    for (std::int64_t axis = 0; axis < 3; ++axis) scales += std::exp(x[static_cast<std::size_t>(n + 3 * i + axis)]);
  }
  return weights.opacity * opacities / n_seen + weights.scale * scales / (3 * n_seen);
}

/// Returns logits and log scales in one vector.
std::vector<double> opacities_and_scales(const GaussianTensors& g) {
  const torch::Tensor all = torch::cat({g.logit_opacities, g.log_scales.flatten()}).to(torch::kFloat64);
  return {all.data_ptr<double>(), all.data_ptr<double>() + all.numel()};
}

/// Returns the first moments after one step from 0, which are 0.1 times the gradients. `image_grad` is the gradient
/// with respect to the image.
GaussianTensors moments_after_step(const RegularizationWeights& weights, float image_grad, torch::Tensor& radii) {
  GaussianTensors gaussians = some_gaussians();
  AdamState state = make_adam_state(gaussians);
  Rasterizer rasterizer(torch::kCPU);
  GaussianOptimizer optimizer(rasterizer);
  RenderSettings settings;
  settings.sh_degree = 1;
  rasterizer.forward(gaussians, tiny_view(), optimizer.begin_view(gaussians, state, settings));
  const RenderedViewGrad grad{torch::full({30, 40, 3}, image_grad), {}, {}};
  radii = optimizer.backward_and_step({1e-3, 1e-3, 1e-3, 1e-3, 1e-3, 1e-3}, grad, gaussians, state, nullptr, weights)
              .radii.clone();
  return state.m;
}

TEST(Regularization, HasTheGradientOfTheMeansOverWhatTheViewSees) {
  for (const RegularizationWeights weights : {RegularizationWeights{0.7, 0}, {0, 1.3}, {0.4, 0.9}}) {
    torch::Tensor radii;
    const GaussianTensors moments = moments_after_step(weights, 0, radii);
    ASSERT_EQ((radii > 0).sum().item<int>(), 9) << "all but those behind the camera";
    const auto value = [&](const std::vector<double>& x) { return regularization(weights, radii, x); };
    std::vector<double> analytic = opacities_and_scales(moments);
    for (double& entry : analytic) entry /= 0.1;
    EXPECT_TRUE(
        test::gradients_agree(analytic, test::numeric_gradient(value, opacities_and_scales(some_gaussians())), 1e-6));
    EXPECT_EQ(moments.means.abs().max().item<float>(), 0) << "no other parameter";
    EXPECT_EQ(moments.sh0.abs().max().item<float>(), 0);
  }
}

TEST(Regularization, AddsToTheGradientOfTheImage) {
  torch::Tensor radii;
  const GaussianTensors image = moments_after_step({}, 0.01f, radii),
                        both = moments_after_step({0.4, 0.9}, 0.01f, radii),
                        alone = moments_after_step({0.4, 0.9}, 0, radii);
  EXPECT_GT(image.logit_opacities.abs().max().item<float>(), 1e-5);
  EXPECT_TRUE(test::within(both.logit_opacities, image.logit_opacities + alone.logit_opacities, 1e-8));
  EXPECT_TRUE(test::within(both.log_scales, image.log_scales + alone.log_scales, 1e-8));
  EXPECT_TRUE(test::same(both.means, image.means));
}

TEST(Regularization, IsFiniteForEveryOpacity) {
  for (const float logit : {-200.0f, -20.0f, 0.0f, 20.0f, 200.0f}) {
    float opacity = 0;
    Vec3f scales{0, 0, 0};
    add_regularization({1, 0}, logit, {0, 0, 0}, opacity, scales);
    EXPECT_NEAR(opacity, std::exp(-std::abs(logit)) / std::pow(1 + std::exp(-std::abs(logit)), 2), 1e-7);
  }
  EXPECT_TRUE(regularization_grad({1, 1}, 0).is_zero()) << "a view that sees nothing";
  EXPECT_TRUE(regularization_grad({}, 5).is_zero());
}

}  // namespace
}  // namespace b3dgs
