// Tests density control on cases small enough to follow by hand.

#include "train/density/strategies/strategies.h"

#include <gtest/gtest.h>

#include <cmath>

#include "core/check.h"
#include "core/parallel.h"
#include "core/random.h"
#include "support/approx.h"
#include "support/expect_error.h"

namespace b3dgs {
namespace {

constexpr float kSmall = 0.01f, kLarge = 0.5f, kHuge = 20.0f;  // world units

/// Thresholds of one round; 0 = none.
struct Rule {
  double grad_threshold = 1, split_scale = 0.1, prune_scale = 0, prune_radius = 0;
  std::int64_t max_gaussians = 0;
  int seed = 1;
};
const Rule kRule;

struct Row {
  float scale, opacity, gradient;
  int views = 1, radius = 5;
};

struct Model {
  GaussianTensors gaussians;
  AdamState adam;
  DensityStatistics statistics;
};

/// Returns a model that contains index i in all values of row i that density control does not read: mean (i, i, i), SH
/// i, moments 100 + i.
Model make_model(const std::vector<Row>& rows) {
  const auto n = static_cast<std::int64_t>(rows.size());
  const torch::Tensor number = torch::arange(n).to(torch::kFloat32);
  const auto numbered = [&](std::vector<std::int64_t> sizes) {
    std::vector<std::int64_t> column(sizes.size(), 1);
    column[0] = n;
    return number.view(column).expand(sizes).clone();
  };
  Model model;
  GaussianTensors& g = model.gaussians;
  g.means = numbered({n, 3});
  g.log_scales = torch::empty({n, 3});
  g.quats = torch::zeros({n, 4});
  g.quats.select(1, 0).fill_(1);
  g.logit_opacities = torch::empty({n});
  g.sh0 = numbered({n, 1, 3});
  g.shN = numbered({n, 3, 3});
  model.adam = make_adam_state(g);
  for (GaussianTensors* moments : {&model.adam.m, &model.adam.v}) {
    for (torch::Tensor* moment : moments->all()) *moment = numbered(moment->sizes().vec()) + 100;
  }
  model.statistics = make_density_statistics(n, torch::kCPU);
  for (std::int64_t i = 0; i < n; ++i) {
    const Row& row = rows[static_cast<std::size_t>(i)];
    // The largest axis decides, and it differs from row to row.
    g.log_scales[i].fill_(std::log(row.scale) - 3.0f);
    g.log_scales[i][i % 3] = std::log(row.scale);
    g.logit_opacities[i] = std::log(row.opacity / (1 - row.opacity));
    model.statistics.grad_norm_sum[i] = row.gradient * static_cast<float>(row.views);
    model.statistics.view_count[i] = row.views;
    model.statistics.max_radii[i] = row.radius;
  }
  return model;
}

std::vector<std::int64_t> sources(const DensityRound& round) {
  const torch::Tensor s = round.edit.sources.contiguous();
  return {s.data_ptr<std::int64_t>(), s.data_ptr<std::int64_t>() + s.numel()};
}

using Rows = std::vector<std::int64_t>;

DensityRound densify(const Model& model, const Rule& rule) {
  constexpr int kIteration = 600;
  TrainConfig config;
  const double extent = rule.prune_scale > 0 ? 10 * rule.prune_scale : 1e6;
  config.densify_grad_threshold = rule.grad_threshold;
  config.percent_dense = rule.split_scale / extent;
  config.prune_opacity = 0.005;
  config.prune_screen_size = rule.prune_radius;
  if (rule.prune_scale > 0 || rule.prune_radius > 0) config.opacity_reset_interval = kIteration - 1;
  config.seed = rule.seed;
  return make_default_strategy(config, extent)
      ->plan_round(model.gaussians, model.statistics, kIteration, rule.max_gaussians);
}

TEST(DefaultStrategy, DoesNotChangeAModelWithSmallGradients) {
  const DensityRound round = densify(make_model({{kSmall, 0.5f, 0.9f}, {kLarge, 0.5f, 0.0f}}), kRule);
  EXPECT_EQ(sources(round), (Rows{0, 1}));
  EXPECT_EQ(round.edit.n_kept, 2);
}

TEST(DefaultStrategy, ClonesSmallOnesExactly) {
  const Model model = make_model({{kSmall, 0.5f, 0.1f}, {kSmall, 0.5f, 1.5f}, {kSmall, 0.5f, 0.1f}});
  const DensityRound round = densify(model, kRule);
  EXPECT_EQ(sources(round), (Rows{0, 1, 2, 1}));
  EXPECT_EQ(round.edit.n_kept, 3);
  EXPECT_EQ(round.n_cloned, 1);
  EXPECT_TRUE(test::same(round.edit.new_means, model.gaussians.means.slice(0, 1, 2)));
  EXPECT_TRUE(test::same(round.edit.new_log_scales, model.gaussians.log_scales.slice(0, 1, 2)));
}

TEST(DefaultStrategy, SplitsLargeOnesInTwoSmallerOnes) {
  const Model model = make_model({{kLarge, 0.5f, 1.5f}, {kSmall, 0.5f, 0.1f}, {kLarge, 0.5f, 1.5f}});
  const DensityRound round = densify(model, kRule);
  EXPECT_EQ(sources(round), (Rows{1, 0, 2, 0, 2})) << "parents are removed; all first samples, then all second samples";
  EXPECT_EQ(round.n_split, 2);
  EXPECT_EQ(round.n_pruned, 0);
  const torch::Tensor shrunk = model.gaussians.log_scales - std::log(1.6f);
  EXPECT_TRUE(
      test::within(round.edit.new_log_scales, torch::stack({shrunk[0], shrunk[2], shrunk[0], shrunk[2]}), 1e-6));
  EXPECT_FALSE(torch::equal(round.edit.new_means[0], round.edit.new_means[2])) << "two samples, not one twice";
}

TEST(DefaultStrategy, ThresholdsAreInclusiveForGradientsAndExclusiveForScales) {
  Model model = make_model({{kSmall, 0.5f, 1.0f}, {kSmall, 0.5f, 0.999f}, {kSmall, 0.5f, 1.0f}});
  const Rule rule = kRule;
  model.gaussians.log_scales[2].fill_(std::log(rule.split_scale / 1e6 * 1e6));  // exactly the limit, so it is cloned
  EXPECT_EQ(sources(densify(model, rule)), (Rows{0, 1, 2, 0, 2}));
}

TEST(DefaultStrategy, AveragesGradientsOverTheViewsThatSawTheGaussian) {
  Model model = make_model({{kSmall, 0.5f, 0.9f, 10}, {kSmall, 0.5f, 1.1f, 10}, {kSmall, 0.5f, 0.0f, 0}});
  EXPECT_EQ(sources(densify(model, kRule)), (Rows{0, 1, 2, 1}));
  // A Gaussian that was never visible has no mean gradient, so it is neither cloned nor split, even if the threshold is
  // 0.
  Rule any = kRule;
  any.grad_threshold = 0;
  EXPECT_EQ(sources(densify(model, any)), (Rows{0, 1, 2, 0, 1}));
}

TEST(DefaultStrategy, PrunesTransparentOnesOldAndNew) {
  const DensityRound round = densify(
      make_model({{kSmall, 0.004f, 0.1f}, {kSmall, 0.004f, 1.5f}, {kLarge, 0.004f, 1.5f}, {kSmall, 0.006f, 0.1f}}),
      kRule);
  EXPECT_EQ(sources(round), (Rows{3}));
  EXPECT_EQ(round.n_pruned, 5) << "rows 0 and 1, the clone of 1, and both samples of 2";
}

TEST(DefaultStrategy, PrunesLargeOnesOnlyWhenAsked) {
  // At 1.6 times the limit, a Gaussian is split and its samples are just small enough.
  const Model model = make_model({{kHuge, 0.5f, 0.1f}, {kLarge, 0.5f, 0.1f}, {7.9f, 0.5f, 1.5f}, {8.1f, 0.5f, 1.5f}});
  EXPECT_EQ(sources(densify(model, kRule)), (Rows{0, 1, 2, 3, 2, 3}));
  Rule rule = kRule;
  rule.prune_scale = 5;
  EXPECT_EQ(sources(densify(model, rule)), (Rows{1, 2, 2}));
}

TEST(DefaultStrategy, PrunesByScreenSizeOnlyWhatWasSeenThatLarge) {
  Rule rule = kRule;
  rule.prune_radius = 20;
  const Model model =
      make_model({{kSmall, 0.5f, 0.1f, 1, 21}, {kSmall, 0.5f, 0.1f, 1, 20}, {kSmall, 0.5f, 1.5f, 1, 21}});
  EXPECT_EQ(sources(densify(model, rule)), (Rows{1, 2})) << "the clone has not been seen yet and stays";
}

TEST(DefaultStrategy, AddsTheCandidatesWithTheLargestGradientsIfThereIsALimit) {
  const Model model = make_model(
      {{kSmall, 0.5f, 2.0f}, {kLarge, 0.5f, 5.0f}, {kSmall, 0.5f, 2.0f}, {kSmall, 0.5f, 3.0f}, {kSmall, 0.5f, 0.1f}});
  Rule rule = kRule;
  rule.max_gaussians = 8;  // 3 of 4 candidates fit, and the first one among equals is taken
  EXPECT_EQ(sources(densify(model, rule)), (Rows{0, 2, 3, 4, 0, 3, 1, 1}));
  rule.max_gaussians = 6;
  EXPECT_EQ(sources(densify(model, rule)), (Rows{0, 2, 3, 4, 1, 1}));
  rule.max_gaussians = 3;
  EXPECT_EQ(sources(densify(model, rule)), (Rows{0, 1, 2, 3, 4}));
  rule.max_gaussians = 9;
  EXPECT_EQ(densify(model, rule).edit.sources.size(0), 9);
}

TEST(DefaultStrategy, SamplesHaveTheShapeOfTheirParent) {
  Model model = make_model(std::vector<Row>(20000, {kLarge, 0.5f, 1.5f}));
  GaussianTensors& g = model.gaussians;
  const std::int64_t n = g.size();
  g.means = torch::tensor({{1.0f, 2.0f, 3.0f}}).repeat({n, 1});
  g.log_scales = torch::tensor({{std::log(2.0f), std::log(0.5f), std::log(0.1f)}}).repeat({n, 1});
  // A quarter turn about z, as a quaternion that is not normalised. x becomes y, and y becomes -x.
  g.quats = torch::tensor({{3.0f, 0.0f, 0.0f, 3.0f}}).repeat({n, 1});
  const DensityRound round = densify(model, kRule);
  ASSERT_EQ(round.edit.new_means.size(0), 2 * n);
  const torch::Tensor offsets = round.edit.new_means - torch::tensor({1.0f, 2.0f, 3.0f});
  const torch::Tensor covariance = offsets.t().mm(offsets) / static_cast<double>(2 * n);
  EXPECT_TRUE(test::within(offsets.mean(0), torch::zeros({3}), 0.05));
  EXPECT_TRUE(test::within(covariance, torch::diag(torch::tensor({0.25f, 4.0f, 0.01f})), 0.15));
  EXPECT_NEAR(covariance[0][0].item<float>(), 0.25, 0.01);
  EXPECT_NEAR(covariance[2][2].item<float>(), 0.01, 0.0005);
}

TEST(DefaultStrategy, DrawsSamplesByRowFromTheSeedAndTheIteration) {
  const Model model = make_model({{kSmall, 0.5f, 0.1f}, {kLarge, 0.5f, 1.5f}, {kLarge, 0.5f, 1.5f}});
  const DensityRound round = densify(model, kRule);
  ASSERT_EQ(sources(round), (Rows{0, 1, 2, 1, 2}));
  const RandomKey key{/*seed=*/1, RandomStream::kSplit, /*iteration=*/600};
  for (int i = 0; i < 4; ++i) {
    const int row = 1 + i % 2, sample = i / 2;
    const auto normal = random_normal(key, static_cast<std::uint64_t>(2 * row + sample));
    for (int axis = 0; axis < 3; ++axis) {  // without rotation, the axes are those of the world
      const float scale = std::exp(model.gaussians.log_scales[row][axis].item<float>());
      EXPECT_NEAR(round.edit.new_means[i][axis].item<float>(), static_cast<float>(row) + scale * normal[axis], 1e-6);
    }
  }
}

TEST(DefaultStrategy, IsTheSameForAnyNumberOfThreadsAndFollowsTheSeed) {
  torch::manual_seed(3);
  Model model = make_model(std::vector<Row>(5000, {kLarge, 0.5f, 1.5f}));
  model.gaussians.quats = torch::randn({5000, 4});
  set_thread_count(1);
  const DensityRound one = densify(model, kRule);
  set_thread_count(3);
  const DensityRound three = densify(model, kRule);
  set_thread_count(0);
  EXPECT_TRUE(test::same(one.edit.new_means, three.edit.new_means));
  Rule with_seed = kRule;
  with_seed.seed = 2;
  const DensityRound other = densify(model, with_seed);
  EXPECT_FALSE(torch::equal(one.edit.new_means, other.edit.new_means));
}

TEST(RowEdit, EditsEveryArrayAlike) {
  Model model =
      make_model({{kSmall, 0.5f, 1.5f}, {kSmall, 0.004f, 0.1f}, {kLarge, 0.5f, 1.5f}, {kSmall, 0.5f, 0.1f, 3}});
  const DensityRound round = densify(model, kRule);
  ASSERT_EQ(sources(round), (Rows{0, 3, 0, 2, 2}));
  apply_row_edit(round.edit, model.gaussians, model.adam, model.statistics);

  const auto first_column = [](const torch::Tensor& t) { return t.reshape({t.size(0), -1}).select(1, 0); };
  const torch::Tensor from = torch::tensor({0.0f, 3.0f, 0.0f, 2.0f, 2.0f});
  EXPECT_TRUE(test::same(first_column(model.gaussians.sh0), from));
  EXPECT_TRUE(test::same(first_column(model.gaussians.shN), from));
  EXPECT_TRUE(test::same(first_column(model.gaussians.means).slice(0, 0, 3), from.slice(0, 0, 3)));
  for (const GaussianTensors* moments : {&model.adam.m, &model.adam.v}) {
    for (const torch::Tensor* moment : moments->all()) {
      EXPECT_TRUE(test::same(first_column(*moment), torch::tensor({100.0f, 103.0f, 0.0f, 0.0f, 0.0f})));
      EXPECT_TRUE(moment->is_contiguous());
    }
  }
  EXPECT_TRUE(test::same(model.statistics.view_count, torch::tensor({1, 3, 0, 0, 0}, torch::kInt32)));
  EXPECT_TRUE(test::same(model.statistics.max_radii, torch::tensor({5, 5, 0, 0, 0}, torch::kInt32)));
  for (const torch::Tensor* parameter : model.gaussians.all()) EXPECT_EQ(parameter->size(0), 5);
}

TEST(RowEdit, CarriesExtraColumnsAlong) {
  Model model =
      make_model({{kSmall, 0.5f, 1.5f}, {kSmall, 0.004f, 0.1f}, {kLarge, 0.5f, 1.5f}, {kSmall, 0.5f, 0.1f, 3}});
  model.statistics.extra.push_back({"age", torch::tensor({7.0f, 8.0f, 9.0f, 10.0f})});
  const DensityRound round = densify(model, kRule);
  apply_row_edit(round.edit, model.gaussians, model.adam, model.statistics);
  EXPECT_TRUE(test::same(model.statistics.extra[0].values, torch::tensor({7.0f, 10.0f, 0.0f, 0.0f, 0.0f})));
}

TEST(RowEdit, GivesNewRowsTheirOpacities) {
  Model model = make_model({{kSmall, 0.5f, 0}, {kSmall, 0.25f, 0}, {kLarge, 0.75f, 0}});
  const torch::Tensor before = model.gaussians.logit_opacities.clone();
  RowEdit edit;
  edit.sources = torch::tensor({0, 2, 2, 1}, torch::kInt64);
  edit.n_kept = 2;
  edit.new_means = torch::zeros({2, 3});
  edit.new_log_scales = torch::zeros({2, 3});
  edit.new_logit_opacities = torch::tensor({3.0f, -4.0f});
  apply_row_edit(edit, model.gaussians, model.adam, model.statistics);
  EXPECT_TRUE(test::same(model.gaussians.logit_opacities,
                         torch::stack({before[0], before[2], torch::tensor(3.0f), torch::tensor(-4.0f)})));
  EXPECT_TRUE(test::same(model.adam.m.logit_opacities, torch::tensor({100.0f, 102.0f, 0.0f, 0.0f})));

  edit.sources = torch::tensor({0, 1, 2, 3, 0}, torch::kInt64);
  edit.n_kept = 4;
  edit.new_means = edit.new_log_scales = torch::zeros({1, 3});
  EXPECT_TRUE(test::fails_with<LogicError>(
      {"4 of 5 rows", "2 new values"}, [&] { apply_row_edit(edit, model.gaussians, model.adam, model.statistics); }));
  edit.new_logit_opacities = torch::Tensor();
  apply_row_edit(edit, model.gaussians, model.adam, model.statistics);
  EXPECT_EQ(model.gaussians.logit_opacities[4].item<float>(), before[0].item<float>()) << "that of the source";
}

TEST(RowEdit, CanRemoveEveryRow) {
  Model model = make_model({{kSmall, 0.004f, 1.5f}, {kLarge, 0.004f, 1.5f}});
  apply_row_edit(densify(model, kRule).edit, model.gaussians, model.adam, model.statistics);
  EXPECT_EQ(model.gaussians.size(), 0);
  EXPECT_EQ(model.adam.v.shN.size(0), 0);
}

TEST(DensityStatistics, CountViewsAndSumNormsInUnitsOfHalfTheImage) {
  DensityStatistics statistics = make_density_statistics(3, torch::kCPU);
  ViewStatistics view;
  view.means2d_grad = torch::tensor({{0.03f, 0.08f}, {0.0f, 0.0f}, {0.5f, 0.0f}});
  view.radii = torch::tensor({4, 0, 9}, torch::kInt32);
  const std::unique_ptr<DensityStrategy> strategy = make_default_strategy({}, 1);
  strategy->after_view({1, view, 200, 100}, statistics);
  view.radii = torch::tensor({2, 0, 11}, torch::kInt32);
  strategy->after_view({1, view, 200, 100}, statistics);
  // (0.03 * 100, 0.08 * 50) = (3, 4)
  EXPECT_TRUE(test::within(statistics.grad_norm_sum, torch::tensor({10.0f, 0.0f, 100.0f}), 1e-5));
  EXPECT_TRUE(test::same(statistics.view_count, torch::tensor({2, 0, 2}, torch::kInt32)));
  EXPECT_TRUE(test::same(statistics.max_radii, torch::tensor({4, 0, 11}, torch::kInt32)));
}

TEST(OpacityReset, LowersOpacitiesAndZeroesOnlyTheirMoments) {
  Model model = make_model({{kSmall, 0.5f, 0}, {kSmall, 0.006f, 0}});
  make_density_strategy({}, 1)->lower_opacities(model.gaussians, model.adam);
  EXPECT_TRUE(test::within(torch::sigmoid(model.gaussians.logit_opacities), torch::tensor({0.01f, 0.006f}), 1e-6));
  EXPECT_EQ(model.adam.m.logit_opacities.abs().max().item<float>(), 0);
  EXPECT_EQ(model.adam.v.logit_opacities.abs().max().item<float>(), 0);
  EXPECT_EQ(model.adam.m.means[1][0].item<float>(), 101);
}

TEST(DensityPlan, ActsAtTheIterationsOfTheOriginal) {
  const TrainConfig config;
  const std::unique_ptr<DensityStrategy> strategy = make_density_strategy(config, 1);
  std::vector<int> rounds, resets;
  for (int iteration = 1; iteration <= config.iterations; ++iteration) {
    const DensityPlan plan = strategy->plan(iteration);
    if (plan.densify) rounds.push_back(iteration);
    if (plan.lower_opacities) resets.push_back(iteration);
    EXPECT_EQ(plan.statistics, iteration < 15000);
  }
  EXPECT_EQ(rounds.front(), 600);
  EXPECT_EQ(rounds.back(), 14900);
  EXPECT_EQ(rounds.size(), 144u);
  EXPECT_EQ(resets, (std::vector<int>{3000, 6000, 9000, 12000}));
}

TEST(DensityPlan, WithAWhiteBackgroundResetsOpacitiesOnceMoreAtTheStart) {
  TrainConfig config;
  EXPECT_FALSE(make_density_strategy(config, 1)->plan(500).lower_opacities);
  config.white_background = true;
  EXPECT_TRUE(make_density_strategy(config, 1)->plan(500).lower_opacities);
}

TEST(DensityStrategy, DefaultFollowsItsScheduleAndTheLimit) {
  TrainConfig config;
  config.densify_grad_threshold = 1;
  const std::unique_ptr<DensityStrategy> strategy = make_density_strategy(config, /*extent=*/10);
  EXPECT_FALSE(strategy->plan(500).densify);
  EXPECT_TRUE(strategy->plan(600).densify);
  EXPECT_TRUE(strategy->plan(3000).lower_opacities);
  EXPECT_EQ(strategy->make_statistics(3, torch::kCPU).all().size(), 3u);

  const Model model = make_model({{kSmall, 0.5f, 2.0f}, {kSmall, 0.5f, 3.0f}, {kLarge, 0.5f, 4.0f}});
  const auto rows_within = [&](std::int64_t limit) {
    return strategy->plan_round(model.gaussians, model.statistics, 600, limit);
  };
  EXPECT_EQ(sources(rows_within(0)).size(), 6u);
  const DensityRound round = rows_within(5);
  EXPECT_EQ(sources(round), (Rows{0, 1, 1, 2, 2}));
  EXPECT_EQ(round.n_over_limit, 1);
}

TEST(DefaultStrategy, PrunesForSizeAfterTheFirstReset) {
  TrainConfig config;
  config.prune_screen_size = 20;
  const std::unique_ptr<DensityStrategy> strategy = make_default_strategy(config, /*extent=*/5);
  const Model model =
      make_model({{0.49f, 0.5f, 0}, {0.51f, 0.5f, 0}, {kSmall, 0.5f, 0, 1, 20}, {kSmall, 0.5f, 0, 1, 21}});
  const auto rows_at = [&](int iteration) {
    return sources(strategy->plan_round(model.gaussians, model.statistics, iteration, 0));
  };
  EXPECT_EQ(rows_at(3000), (Rows{0, 1, 2, 3}));
  EXPECT_EQ(rows_at(3100), (Rows{0, 2}));
}

}  // namespace
}  // namespace b3dgs
