// Tests the decay of SH coefficients by the spread of viewing directions.
#include "train/optimizer/sh_decay.h"

#include <gtest/gtest.h>

#include <cmath>
#include <vector>

#include "support/approx.h"
#include "support/train/tiny_scene.h"
#include "train/density/row_edit.h"
#include "train/optimizer/gaussian_optimizer.h"

namespace b3dgs {
namespace {

constexpr double kStrength = 0.003;
const AdamRates kRates{1e-3, 2e-3, 3e-3, 4e-3, 5e-3, 6e-3};

/// Returns a unit vector at this angle (rad) from the z axis.
Vec3f direction(double angle, double azimuth) {
  return {static_cast<float>(std::sin(angle) * std::cos(azimuth)),
          static_cast<float>(std::sin(angle) * std::sin(azimuth)), static_cast<float>(std::cos(angle))};
}

/// Returns the weight of the last of `n_steps` steps, each along one view at this angle from the axis.
float weight_of_cap(double angle, int n_steps) {
  std::vector<float> row(4, 0.0f);
  float weight = 0;
  for (int step = 0; step < n_steps; ++step) {
    SeenDirections seen;
    seen.add(direction(angle, 2.4 * step), {1, 0, 0});
    weight = sh_decay(sh_decay_args(row.data(), kStrength, 1), 0, seen);
  }
  return weight;
}

TEST(ShDecay, IsInverseToTheSquareOfTheSpreadOfTheDirections) {
  for (const double degrees : {20.0, 45.0, 80.0}) {
    const double angle = degrees * std::acos(-1.0) / 180;
    // The directions run around the axis, so the length of their mean approaches cos(angle).
    const double expected = kStrength / std::pow(1 - std::cos(angle), 2);
    EXPECT_NEAR(weight_of_cap(angle, 2000), expected, 2e-2 * expected) << degrees << " degrees";
  }
  EXPECT_FLOAT_EQ(weight_of_cap(0.01, 2000), 3.0f) << "a limit for almost equal directions";
  EXPECT_FLOAT_EQ(weight_of_cap(1.5, 7), 3.0f) << "few views do not tell the spread";
  EXPECT_LT(weight_of_cap(1.5, 9), 0.1f);
}

TEST(ShDecay, ForgetsOldDirections) {
  std::vector<float> row(4, 0.0f);
  const ShDecayArgs args = sh_decay_args(row.data(), kStrength, 1);
  std::vector<double> sum(4, 0.0);
  for (int step = 0; step < 3000; ++step) {
    const Vec3f dir = direction(step < 1000 ? 2.5 : 0.3, 1.7 * step);
    SeenDirections seen;
    seen.add(dir, {0, 0, 1e-9f});
    sh_decay(args, 0, seen);
    const double added[]{dir.x, dir.y, dir.z, 1};
    for (std::size_t k = 0; k < 4; ++k) sum[k] = (1 - 1.0 / 512) * sum[k] + added[k];
  }
  constexpr double kRounding = 512 * 512 * 6e-8;  // of sums up to 512, about 512 times
  for (std::size_t k = 0; k < 4; ++k) EXPECT_NEAR(row[k], sum[k], kRounding) << k;
  EXPECT_NEAR(row[3], 512 * (1 - std::pow(1 - 1.0 / 512, 3000)), kRounding);
  EXPECT_GT(row[2] / row[3], 0.9) << "the first thousand have faded";
}

TEST(ShDecay, IgnoresViewsWithoutGradientOfTheColour) {
  std::vector<float> row{1, 2, 3, 40};
  SeenDirections seen;
  seen.add({0, 0, 1}, {0, 0, 0});
  EXPECT_EQ(sh_decay(sh_decay_args(row.data(), kStrength, 1), 0, seen), 0);
  EXPECT_EQ(row, (std::vector<float>{1, 2, 3, 40}));
  seen.add({0, 0, 1}, {0, -1, 0});
  EXPECT_EQ(sh_decay({}, 0, seen), 0) << "off";
}

TEST(ShDecay, IsThreeAndSixTimesAsStrongForHigherDegrees) {
  for (int k = 0; k < 15; ++k) {
    EXPECT_FLOAT_EQ(decayed(2, 0.01f, k), static_cast<float>(2 * (1 - 0.01 * (k < 3 ? 1 : k < 8 ? 3 : 6)))) << k;
  }
}

/// Returns some Gaussians, of which the first three are behind every camera.
GaussianTensors some_gaussians() {
  torch::manual_seed(4);
  GaussianTensors g{torch::randn({20, 3}) * 0.3, torch::randn({20, 3}) * 0.3 - 2, torch::randn({20, 4}),
                    torch::randn({20}),          torch::randn({20, 1, 3}) * 0.3,  torch::randn({20, 15, 3}) * 0.1};
  g.means.slice(0, 0, 3).select(1, 2).sub_(50);
  return g;
}

struct Stepped {
  GaussianTensors gaussians = some_gaussians();
  AdamState state = make_adam_state(gaussians);
};

RenderSettings full_degree() {
  RenderSettings settings;
  settings.sh_degree = 3;
  return settings;
}

PinholeView view_at(double x) {
  return to_camera_view(test::look_at_origin(x, 0.1, -3, 40, 30));
}

/// Takes one step along the views at these places, as one view or as a batch.
Stepped step_from(const std::vector<double>& places, bool as_batch, double strength) {
  Stepped result;
  Rasterizer rasterizer(torch::kCPU);
  GaussianOptimizer optimizer(rasterizer, strength);
  torch::manual_seed(5);
  for (const double x : places) {
    rasterizer.forward(result.gaussians, view_at(x),
                       optimizer.begin_view(result.gaussians, result.state, full_degree()));
    const RenderedViewGrad grad{torch::randn({30, 40, 3}) * 0.01, {}, {}};
    if (as_batch) {
      optimizer.make_room_for_view(result.gaussians);
      optimizer.backward_and_keep(view_at(x), full_degree(), grad, result.gaussians);
    } else {
      optimizer.backward_and_step(kRates, grad, result.gaussians, result.state, nullptr);
    }
  }
  if (as_batch) optimizer.step_views(kRates, result.gaussians, result.state, nullptr);
  return result;
}

TEST(ShDecayStep, ShrinksTheCoefficientsOfWhatAViewSees) {
  const GaussianTensors start = some_gaussians();
  for (const std::size_t n_views : {1, 3}) {
    const std::vector<double> places{-0.5, 0.2, 0.9};
    const std::vector<double> own(places.begin(), places.begin() + static_cast<std::ptrdiff_t>(n_views));
    const Stepped with = step_from(own, n_views > 1, kStrength), without = step_from(own, n_views > 1, 0);
    EXPECT_FALSE(without.state.directions.defined());
    // With fewer than 8 views, every visible Gaussian has the largest weight, 1000 x strength. A step along n views has
    // a rate of sqrt(n) times the rate of one, and as many times the decay.
    const double n = static_cast<double>(n_views);
    const double shrink =
        adam_step_size(kRates[kShGroup], static_cast<std::int64_t>(n_views)).step_size * n * 1000 * kStrength;
    const torch::Tensor factors =
        torch::cat({torch::full({3}, 1.0), torch::full({5}, 3.0), torch::full({7}, 6.0)}).view({1, 15, 1});
    const torch::Tensor seen = with.state.directions.select(1, 3) > 0;
    EXPECT_EQ(seen.sum().item<int>(), 17);
    const torch::Tensor expected = -shrink * factors * start.shN * seen.view({20, 1, 1});
    EXPECT_TRUE(test::within(with.gaussians.shN - without.gaussians.shN, expected, 1e-7)) << n_views << " views";
    EXPECT_GT(expected.abs().max().item<double>(), 1e-2);
    EXPECT_TRUE(test::same(with.gaussians.sh0, without.gaussians.sh0));
    EXPECT_TRUE(test::same(with.gaussians.means, without.gaussians.means));
    EXPECT_TRUE(test::same(with.state.m.shN, without.state.m.shN)) << "decoupled from the moments";
  }
}

TEST(ShDecayStep, AddsTheDirectionsFromTheCameras) {
  const GaussianTensors start = some_gaussians();
  const std::vector<double> places{-0.5, 0.2, 0.9};
  torch::Tensor expected = torch::zeros({20, 4});
  for (const double x : places) {
    const Vec3f center = view_at(x).center;
    const torch::Tensor offset = start.means - torch::tensor({center.x, center.y, center.z});
    expected += torch::cat({offset / offset.norm(2, 1, true), torch::ones({20, 1})}, 1);
  }
  expected.slice(0, 0, 3).zero_();  // never seen
  EXPECT_TRUE(test::within(step_from(places, true, kStrength).state.directions, expected, 1e-5));
}

TEST(ShDecayStep, NeedsNoDirectionsWithoutCoefficients) {
  GaussianTensors gaussians = some_gaussians();
  gaussians.shN = torch::zeros({20, 0, 3});
  AdamState state = make_adam_state(gaussians);
  Rasterizer rasterizer(torch::kCPU);
  GaussianOptimizer optimizer(rasterizer, kStrength);
  optimizer.begin_view(gaussians, state, {});
  EXPECT_FALSE(state.directions.defined());
}

TEST(ShDecayStep, NewGaussiansInheritTheDirections) {
  Stepped stepped = step_from({0.2}, false, kStrength);
  DensityStatistics statistics = make_density_statistics(20, torch::kCPU);
  const torch::Tensor before = stepped.state.directions.clone();
  RowEdit edit;
  edit.sources = torch::tensor({1, 5, 19, 7, 7}, torch::kInt64);
  edit.n_kept = 3;
  edit.new_means = torch::zeros({2, 3});
  edit.new_log_scales = torch::zeros({2, 3});
  apply_row_edit(edit, stepped.gaussians, stepped.state, statistics);
  EXPECT_TRUE(test::same(stepped.state.directions, before.index_select(0, edit.sources)));
  EXPECT_GT(stepped.state.directions[4][3].item<float>(), 0);
}

}  // namespace
}  // namespace b3dgs
