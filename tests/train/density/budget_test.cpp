// Compares the parts of strategy budget with plain formulas, and tests whole trainings.

#include "core/config.h"
#include "train/density/strategies/strategies.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <numeric>

#include "core/parallel.h"
#include "core/random.h"
#include "raster/math/covariance.h"
#include "scene/crop_region.h"
#include "support/approx.h"
#include "support/same.h"
#include "support/temp_dir.h"
#include "support/train/tiny_scene.h"
#include "support/train/training.h"
#include "train/loss/loss.h"

namespace b3dgs {
namespace {

using Rows = std::vector<std::int64_t>;

TrainConfig budget_config() {
  TrainConfig config;
  config.strategy = Strategy::kBudget;
  config.score_views = 10;
  config.prune_weight = 0.01;
  config.max_gaussians = 1000;
  return config;
}

struct BudgetModel {
  GaussianTensors gaussians;
  DensityStatistics statistics;
};

/// Returns different Gaussians with opacity 0.5, all of them candidates with score 1, and never scored for their
/// weight.
BudgetModel make_model(std::int64_t n) {
  const torch::Tensor wave = torch::sin(torch::arange(12 * n, torch::kFloat32) * 1.3f);
  BudgetModel model;
  GaussianTensors& g = model.gaussians;
  g.means = wave.slice(0, 0, 3 * n).view({n, 3}).clone() * 5;
  g.log_scales = wave.slice(0, 3 * n, 6 * n).view({n, 3}).clone();
  g.quats = wave.slice(0, 6 * n, 10 * n).view({n, 4}).clone() + 0.1f;
  g.logit_opacities = torch::zeros({n});
  g.sh0 = torch::zeros({n, 1, 3});
  g.shN = torch::zeros({n, 0, 3});
  model.statistics = make_budget_strategy(budget_config(), 1)->make_statistics(n, torch::kCPU);
  model.statistics.extra[0].values.fill_(1);
  return model;
}

torch::Tensor& column(BudgetModel& model, BudgetColumn which) {
  return model.statistics.extra.at(static_cast<std::size_t>(which)).values;
}

DensityRound plan_round(const TrainConfig& config, const BudgetModel& model, int iteration, std::int64_t limit = 0) {
  return make_budget_strategy(config, 1)->plan_round(model.gaussians, model.statistics, iteration, limit);
}

Rows to_rows(const torch::Tensor& tensor) {
  const torch::Tensor rows = tensor.contiguous();
  return {rows.data_ptr<std::int64_t>(), rows.data_ptr<std::int64_t>() + rows.numel()};
}

/// Returns the rows that a round splits, and checks the structure of its edit.
Rows parents_of(const DensityRound& round) {
  const Rows sources = to_rows(round.edit.sources);
  const auto kept = sources.begin() + round.edit.n_kept;
  const auto n = static_cast<std::ptrdiff_t>(round.n_split);
  EXPECT_EQ(sources.end() - kept, 2 * n);
  const Rows first(kept, kept + n), second(kept + n, sources.end());
  EXPECT_EQ(first, second) << "all first parts, then all second ones";
  EXPECT_TRUE(std::is_sorted(first.begin(), first.end()));
  for (const std::int64_t row : first) EXPECT_FALSE(std::binary_search(sources.begin(), kept, row)) << row << " stays";
  EXPECT_EQ(round.edit.new_means.sizes(), (std::vector<std::int64_t>{2 * n, 3}));
  EXPECT_EQ(round.edit.new_logit_opacities.numel(), 2 * n);
  return first;
}

constexpr int kLastRound = 14900;  // closes the whole distance to the budget

TEST(BudgetStrategy, DrawsParentsInProportionToTheirScores) {
  const std::int64_t n = 400, n_drawn = 60;
  BudgetModel model = make_model(n);
  torch::Tensor& scores = column(model, BudgetColumn::kErrorSum);
  scores.copy_(torch::arange(n).remainder(7) * torch::arange(n).remainder(5));  // some are 0 and never drawn
  model.gaussians.logit_opacities.slice(0, 300, 310).fill_(-6);                 // pruned
  TrainConfig config = budget_config();
  config.max_gaussians = n - 10 + n_drawn;
  config.seed = 5;
  const Rows found = parents_of(plan_round(config, model, kLastRound));

  // In the reference, keys ln(u) / score are computed in double, and the largest are drawn.
  std::vector<std::pair<double, std::int64_t>> keys;
  for (std::int64_t i = 0; i < n; ++i) {
    const double score = scores[i].item<double>();
    if (score == 0 || (i >= 300 && i < 310)) continue;
    const auto bits = random_bits({5, RandomStream::kParents, kLastRound}, static_cast<std::uint64_t>(i))[0];
    keys.emplace_back(-std::log((bits + 0.5) / 4294967296.0) / score, i);
  }
  std::sort(keys.begin(), keys.end());
  Rows expected;
  for (std::size_t k = 0; k < static_cast<std::size_t>(n_drawn); ++k) expected.push_back(keys[k].second);
  std::sort(expected.begin(), expected.end());
  EXPECT_EQ(found, expected);
}

TEST(BudgetStrategy, DrawsAsOftenAsTheScoresSay) {
  // Two of three rows are drawn, with scores 1, 1 and 8. The last one is left out with probability 2 x 1/10 x 1/9.
  BudgetModel model = make_model(3);
  column(model, BudgetColumn::kErrorSum).copy_(torch::tensor({1.0f, 1.0f, 8.0f}));
  TrainConfig config = budget_config();
  config.max_gaussians = 5;
  int n_without = 0;
  constexpr int kDraws = 2000;
  for (config.seed = 0; config.seed < kDraws; ++config.seed) {
    const Rows rows = parents_of(plan_round(config, model, kLastRound));
    ASSERT_EQ(rows.size(), 2u);
    n_without += rows == Rows{0, 1};
  }
  EXPECT_NEAR(n_without, kDraws * 2.0 / 90, 5 * std::sqrt(kDraws * 2.0 / 90));
}

TEST(BudgetStrategy, SplitsMostlyInsideOfTheRegion) {
  const std::int64_t n = 400;
  BudgetModel model = make_model(n);
  column(model, BudgetColumn::kErrorSum).copy_(torch::arange(n).remainder(3) + 1);
  const auto* const means = model.gaussians.means.data_ptr<float>();
  const auto plan = [&](const char* region, std::int64_t n_added) {
    TrainConfig config = budget_config();
    config.max_gaussians = n + n_added;
    const std::unique_ptr<DensityStrategy> strategy = make_density_strategy(config, 1);
    strategy->set_region(parse_crop(region));
    return parents_of(strategy->plan_round(model.gaussians, model.statistics, kLastRound, 0));
  };
  for (const char* region : {"-5,-5,0,5,5,5", "0,0,5,7.5"}) {
    const CropRegion inside = parse_crop(region);
    const auto is_inside = [&](std::int64_t row) {
      return inside.contains({means[3 * row], means[3 * row + 1], means[3 * row + 2]});
    };
    std::int64_t n_inside = 0;
    for (std::int64_t row = 0; row < n; ++row) n_inside += is_inside(row);
    ASSERT_GT(n_inside, 100);
    ASSERT_LT(n_inside, 300);
    const Rows few = plan(region, 100), many = plan(region, n);
    EXPECT_EQ(few.size(), 100u);
    EXPECT_EQ(std::count_if(few.begin(), few.end(), is_inside), 90);
    // If all inside are split, the others do not take their place.
    EXPECT_EQ(std::count_if(many.begin(), many.end(), is_inside), n_inside);
    EXPECT_EQ(static_cast<std::int64_t>(many.size()) - n_inside, n / 10);
  }
}

TEST(BudgetStrategy, SplitsAlongTheLongestAxis) {
  const std::int64_t n = 20;
  const BudgetModel model = make_model(n);
  const DensityRound round = plan_round(budget_config(), model, kLastRound);
  ASSERT_EQ(parents_of(round).size(), static_cast<std::size_t>(n));
  const double distance = 0.5, longest = std::sqrt(0.75),
               opacity = 1 / std::sqrt(3) + 0.107 * 0.5;  // for a parent with 0.5
  for (std::int64_t i = 0; i < n; ++i) {
    const auto axis = model.gaussians.log_scales[i].argmax().item<std::int64_t>();
    // The direction of the axis is a unit vector rotated by the quaternion, v + 2 u x (u x v + w v).
    torch::Tensor q = model.gaussians.quats[i].to(torch::kFloat64);
    q = q / q.norm();
    const torch::Tensor u = q.slice(0, 1), v = torch::eye(3, torch::kFloat64)[axis];
    const torch::Tensor direction = v + 2 * torch::linalg_cross(u, torch::linalg_cross(u, v) + q[0] * v);
    const double sigma = std::exp(model.gaussians.log_scales[i][axis].item<double>());
    for (const int side : {0, 1}) {
      const std::int64_t part = side * n + i;
      const torch::Tensor moved = round.edit.new_means[part].to(torch::kFloat64) - model.gaussians.means[i];
      EXPECT_TRUE(test::within(moved, (side == 0 ? 1 : -1) * distance * sigma * direction, 2e-6));
      torch::Tensor factors = torch::ones({3}, torch::kFloat64);
      factors[axis] = longest;
      const torch::Tensor scaled = round.edit.new_log_scales[part].to(torch::kFloat64) - model.gaussians.log_scales[i];
      EXPECT_TRUE(test::within(scaled.exp(), factors, 1e-6));
      EXPECT_NEAR(1 / (1 + std::exp(-round.edit.new_logit_opacities[part].item<double>())), 0.5 * opacity, 1e-6);
    }
    // Variance of the mixture along the axis, relative to that of the parent.
    EXPECT_NEAR(distance * distance + longest * longest, 1, 1e-12);
  }
}

/// Returns the root mean square difference between the images of a parent and of its two parts, composited, relative to
/// the parent's image. The view is along the shortest axis.
double split_image_error(double opacity) {
  BudgetModel model = make_model(1);
  model.gaussians.means.zero_();
  model.gaussians.log_scales.copy_(torch::tensor({{1.0f, 0.8f, 0.1f}}).log());
  model.gaussians.quats.copy_(torch::tensor({{1.0f, 0.0f, 0.0f, 0.0f}}));
  model.gaussians.logit_opacities.fill_(std::log(opacity / (1 - opacity)));
  const DensityRound round = plan_round(budget_config(), model, kLastRound);
  const auto alpha = [](const torch::Tensor& mean, const torch::Tensor& log_scale, double logit, double x, double y) {
    const double u = (x - mean[0].item<double>()) / std::exp(log_scale[0].item<double>()),
                 v = (y - mean[1].item<double>()) / std::exp(log_scale[1].item<double>());
    return std::exp(-0.5 * (u * u + v * v)) / (1 + std::exp(-logit));
  };
  double difference = 0, total = 0;
  for (double x = -4; x <= 4; x += 0.25) {
    for (double y = -4; y <= 4; y += 0.25) {
      const double parent = alpha(model.gaussians.means[0], model.gaussians.log_scales[0],
                                  model.gaussians.logit_opacities[0].item<double>(), x, y);
      double transmittance = 1;
      for (const int part : {0, 1}) {
        transmittance *= 1 - alpha(round.edit.new_means[part], round.edit.new_log_scales[part],
                                   round.edit.new_logit_opacities[part].item<double>(), x, y);
      }
      difference += std::pow(1 - transmittance - parent, 2);
      total += parent * parent;
    }
  }
  return std::sqrt(difference / total);
}

TEST(BudgetStrategy, PartsPreserveTheImage) {
  for (const double opacity : {0.02, 0.3, 0.6, 0.9, 0.99}) {
    SCOPED_TRACE(opacity);
    EXPECT_LT(split_image_error(opacity), 0.02 + 0.09 * opacity);
  }
}

TEST(BudgetStrategy, GrowsAlongTheCurveToTheBudget) {
  TrainConfig config;
  constexpr std::int64_t kStart = 10000, kBudget = 150000;
  std::int64_t n = kStart;
  for (int iteration = 600; iteration <= kLastRound; iteration += 100) {
    ASSERT_TRUE(is_growth_round(config, iteration));
    n += budget_growth(config, iteration, n, kBudget);
    const double t = (iteration - 500) / 14400.0;
    EXPECT_NEAR(static_cast<double>(n), kStart + (kBudget - kStart) * std::sqrt(t), 100) << iteration;
  }
  EXPECT_EQ(n, kBudget);
  EXPECT_EQ(budget_growth(config, 600, 100, 100), 0);
  EXPECT_EQ(budget_growth(config, 600, 200, 100), 0) << "more than the budget: none is added";
  EXPECT_FALSE(is_growth_round(config, 500));
  EXPECT_FALSE(is_growth_round(config, 650));
  EXPECT_FALSE(is_growth_round(config, 15000));
}

TEST(BudgetStrategy, KeepsWithinTheLimitAndSaysHowManyItLeavesOut) {
  const BudgetModel model = make_model(10);
  TrainConfig config = budget_config();
  config.max_gaussians = 18;
  EXPECT_EQ(parents_of(plan_round(config, model, kLastRound)).size(), 8u);
  const DensityRound short_of_memory = plan_round(config, model, kLastRound, /*limit=*/13);
  EXPECT_EQ(parents_of(short_of_memory).size(), 3u);
  EXPECT_EQ(short_of_memory.n_over_limit, 5);
  const DensityRound full = plan_round(config, model, kLastRound, /*limit=*/7);
  EXPECT_EQ(to_rows(full.edit.sources).size(), 10u) << "there are more already: none is added, none removed";
  EXPECT_EQ(full.n_over_limit, 8);
  config.max_gaussians = 0;
  EXPECT_EQ(parents_of(plan_round(config, model, 600)).size(), 10u) << "no budget: all candidates";
}

TEST(BudgetStrategy, ChangesNothingWithoutCandidates) {
  BudgetModel model = make_model(6);
  column(model, BudgetColumn::kErrorSum).zero_();
  for (const int iteration : {kLastRound, 15000}) {
    const DensityRound round = plan_round(budget_config(), model, iteration);
    EXPECT_EQ(to_rows(round.edit.sources), (Rows{0, 1, 2, 3, 4, 5}));
    EXPECT_EQ(round.edit.n_kept, 6);
    EXPECT_EQ(round.edit.new_means.sizes(), (std::vector<std::int64_t>{0, 3}));
    EXPECT_EQ(round.n_pruned + round.n_split + round.n_over_limit, 0);
  }
  const DensityRound empty = plan_round(budget_config(), make_model(0), kLastRound);
  EXPECT_EQ(empty.edit.sources.numel(), 0);
}

TEST(BudgetStrategy, RemovesTransparentOnesAndThoseThatHardlyContribute) {
  BudgetModel model = make_model(5);
  column(model, BudgetColumn::kErrorSum).zero_();
  model.gaussians.logit_opacities[0] = std::log(0.004f / 0.996f);
  column(model, BudgetColumn::kScoreViews).copy_(torch::tensor({40.0f, 20.0f, 19.0f, 20.0f, 0.0f}));
  column(model, BudgetColumn::kMaxWeight).copy_(torch::tensor({0.9f, 0.0099f, 0.0f, 0.0101f, 0.0f}));
  TrainConfig config = budget_config();
  EXPECT_EQ(to_rows(plan_round(config, model, 600).edit.sources), (Rows{1, 2, 3, 4})) << "opacity, in any round";
  const DensityRound round = plan_round(config, model, 3000);
  EXPECT_EQ(to_rows(round.edit.sources), (Rows{2, 3, 4})) << "row 2 was seen by too few views, row 3 contributes";
  EXPECT_EQ(round.n_pruned, 2);
  EXPECT_EQ(to_rows(plan_round(config, model, 27000).edit.sources), (Rows{2, 3, 4})) << "after growth, too";
  EXPECT_EQ(to_rows(plan_round(config, model, 30000).edit.sources), (Rows{1, 2, 3, 4}));
  config.prune_weight = 0;
  EXPECT_EQ(to_rows(plan_round(config, model, 3000).edit.sources), (Rows{1, 2, 3, 4}));
}

TEST(BudgetStrategy, RemembersWeightsBetweenTheRoundsThatUseThem) {
  TrainConfig config = budget_config();
  const auto sums_after = [&](int iteration) {
    BudgetModel model = make_model(4);
    for (torch::Tensor* own : model.statistics.all()) own->fill_(1);
    make_budget_strategy(config, 1)->end_round(iteration, model.statistics);
    std::vector<double> sums;
    for (const torch::Tensor* own : model.statistics.all()) sums.push_back(own->sum().item<double>());
    return sums;
  };
  EXPECT_EQ(sums_after(600), (std::vector<double>{0, 0, 0, 0, 4, 4}));
  EXPECT_EQ(sums_after(3000), std::vector<double>(6, 0.0));
  config.opacity_reset_interval = 985;  // not a multiple of the interval of growth, as a user may choose it
  EXPECT_EQ(sums_after(985), (std::vector<double>{4, 4, 4, 4, 0, 0})) << "the growth round at 1000 needs its scores";
  config.prune_weight = 0;
  EXPECT_EQ(sums_after(600), std::vector<double>(6, 0.0));
}

TEST(BudgetStrategy, ScoresTheStepsBeforeEachRound) {
  TrainConfig config = budget_config();
  const std::unique_ptr<DensityStrategy> strategy = make_density_strategy(config, 1);
  std::vector<int> scored;
  for (int i = 1; i <= 30000; ++i) {
    const DensityPlan plan = strategy->plan(i);
    if (plan.score) scored.push_back(i);
    EXPECT_EQ(plan.statistics, plan.score);
    EXPECT_EQ(plan.densify, (i > 500 && i < 15000 && i % 100 == 0) || (i > 500 && i < 28000 && i % 3000 == 0)) << i;
    EXPECT_FALSE(plan.lower_opacities);
  }
  EXPECT_EQ(scored.front(), 591);
  EXPECT_EQ(scored[9], 600);
  EXPECT_EQ(scored[10], 691);
  EXPECT_EQ(scored.back(), 27000);
  EXPECT_EQ(scored.size(), 10u * 265);
  config.prune_weight = 0;
  EXPECT_FALSE(make_density_strategy(config, 1)->plan(15000).score);
  config.score_views = 1000;
  EXPECT_TRUE(make_density_strategy(config, 1)->plan(501).score);
}

TEST(BudgetStrategy, AccumulatesScoresOfItsSteps) {
  const Scene scene = test::make_tiny_scene();
  const GaussianTensors gaussians = [] {
    BudgetModel model = make_model(30);
    model.gaussians.means *= 0.1f;
    model.gaussians.log_scales -= 2.5f;
    return model.gaussians;
  }();
  Rasterizer rasterizer(torch::kCPU);
  const RenderSettings settings;
  const Camera& camera = scene.train[0].camera;
  const RenderedView view = rasterizer.forward(gaussians, to_camera_view(camera), settings);
  const torch::Tensor grad = torch::sin(torch::arange(view.color.numel(), torch::kFloat32)).view(view.color.sizes());
  GaussianTensors grads;
  const ViewStatistics statistics = rasterizer.backward(gaussians, {grad, {}, {}}, grads);
  const torch::Tensor error = torch::rand({camera.height, camera.width});

  TrainConfig config = budget_config();
  const std::unique_ptr<DensityStrategy> strategy = make_budget_strategy(config, 1);
  DensityStatistics sums = strategy->make_statistics(gaussians.size(), torch::kCPU);
  const auto take_step = [&](int iteration) {
    const auto add_scores = [&](const GaussianScores& scores) { rasterizer.score(error, scores); };
    strategy->after_view({iteration, statistics, camera.width, camera.height, add_scores}, sums);
  };
  take_step(650);  // not scored
  EXPECT_EQ(sums.extra[0].values.abs().max().item<float>(), 0);
  take_step(700);
  GaussianScores expected{torch::zeros({30}), torch::zeros({30}), torch::zeros({30}), {}};
  rasterizer.score(error, expected);
  EXPECT_TRUE(test::same(sums.extra[0].values, expected.error_sum));
  EXPECT_TRUE(test::same(sums.extra[1].values, expected.max_weight));
  EXPECT_TRUE(test::same(sums.extra[2].values, expected.n_views));
  EXPECT_GT(expected.error_sum.max().item<float>(), 1);
}

TEST(ErrorImage, IsTheSquareOfTheMeanDifferenceOverTheChannels) {
  const torch::Tensor rendered = torch::tensor({0.5f, 0.0f, 1.0f, -3.0f, 0.2f, 0.2f, 0.1f, 0.1f, 0.1f}).view({1, 3, 3});
  const torch::Tensor truth = torch::tensor({255, 51, 255, 255, 255, 255, 0, 0, 0}, torch::kUInt8).view({1, 3, 3});
  ErrorImage image;
  image.compute(rendered, truth, {});
  EXPECT_TRUE(test::within(image.error(), torch::tensor({{0.49f / 9, 1.0f, 0.01f}}), 1e-6)) << "at most 1";
  image.compute(rendered, truth, torch::tensor({{1, 1, 0}}, torch::kUInt8));
  EXPECT_TRUE(test::within(image.error(), torch::tensor({{0.49f / 9, 1.0f, 0.0f}}), 1e-6)) << "invalid: 0";
}

// Whole trainings

TEST(BudgetTraining, LearnsASceneWithinItsBudget) {
  const Scene scene = test::make_tiny_scene(test::learnable_scene());
  const test::TempDir temp;
  TrainConfig config = test::growing_budget_config(800, 600);
  config.score_views = 10;
  config.prune_weight = 0.01;
  config.test_iterations = {1};
  std::int64_t most = 0;
  TrainHooks hooks;
  hooks.on_progress = [&](const TrainProgress& progress) { most = std::max(most, progress.n_gaussians); };
  const TrainResult result = Trainer(finalize(config, scene), scene, ModelFolder(temp.path()), hooks).run();
  EXPECT_LE(most, 150);
  EXPECT_GT(most, 120);
  EXPECT_GT(result.evaluations.back().second.mean.psnr, 29);
}

}  // namespace
}  // namespace b3dgs
