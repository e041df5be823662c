// Tests the arithmetic and the rounds of strategy mcmc.

#include "train/density/strategies/strategies.h"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <numeric>
#include <vector>

#include "core/parallel.h"
#include "core/random.h"
#include "core/vec.h"
#include "raster/math/opacity.h"
#include "support/approx.h"
#include "train/density/strategies/mcmc_math.h"
#include "train/optimizer/adam.h"

namespace b3dgs {
namespace {

// --- Copies ---

TEST(McmcCopies, HaveTheOpacityAndScaleOfThePapersSums) {
  for (const double opacity : {0.006, 0.1, 0.5, 0.9, 0.999}) {
    const double x = std::log(opacity / (1 - opacity));
    for (int n = 2; n <= kMaxCopies; ++n) {
      const double each = 1 / (1 + std::exp(-shared_logit(x, n)));
      EXPECT_NEAR(1 - std::pow(1 - each, n), opacity, 1e-12) << "light that passes through all copies at the centre";
      // The two sums as in the paper, in extended precision.
      long double sum = 0;
      for (int i = 1; i <= n; ++i) {
        long double choose = 1;  // C(i - 1, k)
        for (int k = 0; k < i; ++k) {
          sum += choose * (k % 2 == 0 ? 1 : -1) * std::pow(static_cast<long double>(each), k + 1) /
                 std::sqrt(static_cast<long double>(k + 1));
          choose = choose * (i - 1 - k) / (k + 1);
        }
      }
      EXPECT_NEAR(std::exp(log_shrink(x, n)), static_cast<double>(opacity / sum), 1e-9) << opacity << ", " << n;
    }
  }
}

TEST(McmcCopies, KeepTheOpacitySummedOverALine) {
  // Alpha of N copies at distance t from the centre is 1 - (1 - o' exp(-t^2 / 2 s'^2))^N. Its integral equals that of
  // the original Gaussian.
  for (const double opacity : {0.05, 0.7, 0.99}) {
    const double x = std::log(opacity / (1 - opacity));
    for (const int n : {2, 3, 20, 51}) {
      const double each = 1 / (1 + std::exp(-shared_logit(x, n))), scale = std::exp(log_shrink(x, n));
      double integral = 0;
      constexpr double kStep = 0.01;
      for (int k = -1500; k <= 1500; ++k) {
        const double t = kStep * k / scale;
        integral += kStep * (1 - std::pow(1 - each * std::exp(-0.5 * t * t), n));
      }
      EXPECT_NEAR(integral, opacity * std::sqrt(2 * kPi), 1e-8) << opacity << ", " << n;
    }
  }
}

TEST(McmcCopies, AreFiniteForEveryOpacity) {
  for (const double x : {-80.0, -30.0, -5.3, 16.0, 20.0, 80.0, 1000.0}) {
    for (const int n : {2, 51}) {
      EXPECT_TRUE(std::isfinite(log_shrink(x, n))) << x << ", " << n;
      EXPECT_LT(log_shrink(x, n), 1e-12) << "copies are not larger";
      EXPECT_TRUE(std::isfinite(shared_logit(x, n))) << x << ", " << n;
      EXPECT_LT(shared_logit(x, n), x);
    }
  }
  EXPECT_NEAR(shared_logit(-80, 2), -80 - std::log(2.0), 1e-9) << "nearly transparent ones share their opacity";
  EXPECT_NEAR(shared_logit(1000, 4), 250, 1e-9);
}

// --- Draws ---

/// Draws n rows with these weights.
std::vector<std::int64_t> draws_from(const std::vector<std::int64_t>& weights, std::int64_t n) {
  std::vector<std::int64_t> sums(weights.size());
  std::partial_sum(weights.begin(), weights.end(), sums.begin());
  std::vector<std::int64_t> rows(static_cast<std::size_t>(n));
  DrawArgs args;
  args.n_rows = static_cast<std::int64_t>(weights.size());
  args.sums = sums.data();
  args.key = {5, RandomStream::kRelocation, 600};
  args.out = rows.data();
  for (std::int64_t i = 0; i < n; ++i) draw_row(args, i);
  return rows;
}

TEST(McmcDraws, AreInProportionToTheWeights) {
  const std::vector<std::int64_t> weights{0, 0, 3, 1, 0, 400, 0, 96, 0};
  constexpr int kDraws = 200000;
  std::vector<double> counts(weights.size());
  for (const std::int64_t row : draws_from(weights, kDraws)) ++counts[static_cast<std::size_t>(row)];
  for (std::size_t i = 0; i < weights.size(); ++i) {
    const double p = static_cast<double>(weights[i]) / 500, expected = kDraws * p;
    EXPECT_NEAR(counts[i], expected, 5 * std::sqrt(expected * (1 - p))) << "row " << i;  // 0 for weight 0
  }
}

TEST(McmcDraws, ReachTheOnlyLiveRow) {
  EXPECT_EQ(draws_from({0, 1, 0}, 50), std::vector<std::int64_t>(50, 1));
  EXPECT_EQ(draws_from({0, 0, std::int64_t{1} << 60}, 50), std::vector<std::int64_t>(50, 2));
}

TEST(McmcDraws, GiveDeadGaussiansNoWeight) {
  const float dead = logit(0.005);
  EXPECT_EQ(draw_weight(dead, dead), 0) << "at most the threshold";
  EXPECT_NEAR(static_cast<double>(draw_weight(std::nextafter(dead, 0.0f), dead)), 0.005 * 0x1p32, 100);
  EXPECT_EQ(draw_weight(0, dead), std::int64_t{1} << 31);
  EXPECT_EQ(draw_weight(NAN, dead), 0);
  EXPECT_EQ(draw_weight(-80, -INFINITY), 1) << "live, however transparent";
  EXPECT_EQ(draw_weight(INFINITY, INFINITY), 0) << "--prune_opacity 1";
}

// --- Rounds ---

struct McmcModel {
  GaussianTensors gaussians;
  AdamState adam;
  DensityStatistics statistics;
};

/// Returns a model with different means and moments in each row.
McmcModel make_model(const torch::Tensor& opacities) {
  const std::int64_t n = opacities.size(0);
  McmcModel model;
  torch::manual_seed(8);
  model.gaussians = {torch::randn({n, 3}),    torch::randn({n, 3}) * 0.3 - 2, torch::randn({n, 4}),
                     torch::logit(opacities), torch::randn({n, 1, 3}),        torch::randn({n, 3, 3})};
  model.adam = make_adam_state(model.gaussians);
  for (GaussianTensors* moments : {&model.adam.m, &model.adam.v}) {
    for (torch::Tensor* moment : moments->all()) *moment = torch::rand_like(*moment) + 1;
  }
  model.statistics = make_density_statistics(n, torch::kCPU);
  return model;
}

std::vector<std::int64_t> indices_of(const torch::Tensor& rows) {
  const torch::Tensor r = rows.contiguous();
  return {r.data_ptr<std::int64_t>(), r.data_ptr<std::int64_t>() + r.numel()};
}

constexpr McmcRule kRule{/*prune_opacity=*/0.005, /*growth=*/0.05, /*max_gaussians=*/0};

TEST(McmcRound, MovesDeadOnesAndGrowsWithoutChangingWhatPassesThrough) {
  torch::Tensor opacities = torch::rand({400}) * 0.9 + 0.01;
  opacities.slice(0, 0, 400, 5).fill_(0.004f);  // 80 dead ones
  opacities[17] = 0.999f;
  McmcModel model = make_model(opacities);
  const McmcModel before = make_model(opacities);
  McmcRule rule = kRule;
  rule.growth = 0.3;
  const DensityRound round = plan_mcmc_round(model.gaussians, rule, 3, 600);
  EXPECT_EQ(round.n_pruned, 80);
  EXPECT_EQ(round.n_cloned, 80 + 120);
  EXPECT_EQ(round.n_over_limit, 0);
  ASSERT_EQ(round.edit.sources.size(0), 520);
  apply_row_edit(round.edit, model.gaussians, model.adam, model.statistics);

  // All copies of a Gaussian together let as much light through as the Gaussian that they replace.
  const std::vector<std::int64_t> sources = indices_of(round.edit.sources);
  std::vector<double> passes(400, 1);
  std::vector<int> copies(400, 0);
  const torch::Tensor after = torch::sigmoid(model.gaussians.logit_opacities.to(torch::kFloat64));
  for (std::size_t i = 0; i < sources.size(); ++i) {
    const auto source = static_cast<std::size_t>(sources[i]);
    passes[source] *= 1 - after[static_cast<std::int64_t>(i)].item<double>();
    ++copies[source];
  }
  int n_copied = 0;
  for (std::int64_t i = 0; i < 400; ++i) {
    const auto row = static_cast<std::size_t>(i);
    const bool is_dead = i % 5 == 0;
    EXPECT_EQ(copies[row] == 0, is_dead) << "row " << i;
    EXPECT_NEAR(1 - passes[row], is_dead ? 0 : opacities[i].item<double>(), 2e-6) << "row " << i;
    n_copied += copies[row] > 1;
  }
  EXPECT_GT(n_copied, 100);

  // Rows without copies keep their moments. All copies start with zero moments.
  EXPECT_EQ(round.edit.n_kept, 320 - n_copied);
  for (std::size_t i = 0; i < sources.size(); ++i) {
    const auto row = static_cast<std::int64_t>(i);
    const bool is_kept = row < round.edit.n_kept;
    EXPECT_EQ(copies[static_cast<std::size_t>(sources[i])] == 1, is_kept);
    EXPECT_TRUE(test::same(model.gaussians.means[row], before.gaussians.means[sources[i]]));
    EXPECT_TRUE(test::same(model.gaussians.sh0[row], before.gaussians.sh0[sources[i]]));
    EXPECT_EQ(torch::equal(model.gaussians.log_scales[row], before.gaussians.log_scales[sources[i]]), is_kept);
    EXPECT_EQ(torch::equal(model.gaussians.logit_opacities[row], before.gaussians.logit_opacities[sources[i]]),
              is_kept);
    EXPECT_EQ(model.adam.v.means[row].abs().max().item<float>() > 0, is_kept);
    EXPECT_EQ(model.adam.m.shN[row].abs().max().item<float>() > 0, is_kept);
  }
}

TEST(McmcRound, SharesOneGaussianAmongItsCopies) {
  McmcModel model = make_model(torch::tensor({0.8f, 0.001f, 0.001f}));
  McmcRule rule = kRule;
  rule.growth = 1;
  rule.max_gaussians = 5;
  const torch::Tensor scales = model.gaussians.log_scales[0].clone();
  const DensityRound round = plan_mcmc_round(model.gaussians, rule, 3, 600);
  EXPECT_EQ(indices_of(round.edit.sources), (std::vector<std::int64_t>{0, 0, 0, 0, 0}));
  EXPECT_EQ(round.edit.n_kept, 0);
  EXPECT_EQ(round.n_over_limit, 1);
  // There are three copies. Then two of those are copied once more, or one of them twice.
  const double x = model.gaussians.logit_opacities[0].item<double>(), of_three = shared_logit(x, 3);
  for (std::int64_t i = 0; i < 5; ++i) {
    const double found = round.edit.new_logit_opacities[i].item<double>();
    int n = 1;
    while (n < 3 && std::abs(found - (n == 1 ? of_three : shared_logit(of_three, n))) > 1e-5) ++n;
    EXPECT_NEAR(found, n == 1 ? of_three : shared_logit(of_three, n), 1e-5);
    const double shrink = log_shrink(x, 3) + (n == 1 ? 0 : log_shrink(of_three, n));
    EXPECT_TRUE(test::within(round.edit.new_log_scales[i], scales + shrink, 1e-5));
  }
}

// If opacities just above the limit were shared among copies, the copies would be below it.
TEST(McmcRound, MakesNoCopyThatIsDeadAtBirth) {
  torch::Tensor opacities = torch::full({300}, 0.001f);
  opacities.slice(0, 0, 20).fill_(0.006f);
  const McmcModel model = make_model(opacities);
  const DensityRound round = plan_mcmc_round(model.gaussians, {0.005, 0.5, 0}, 3, 600);
  ASSERT_EQ(round.edit.sources.size(0), 450);
  const float dead = logit(0.005);
  EXPECT_GT(round.edit.new_logit_opacities.min().item<float>(), dead);
  EXPECT_LT(round.edit.new_logit_opacities.max().item<float>(), logit(0.0051)) << "all of them share";
  McmcModel edited = model;
  apply_row_edit(round.edit, edited.gaussians, edited.adam, edited.statistics);
  EXPECT_EQ(plan_mcmc_round(edited.gaussians, {0.005, 0, 0}, 3, 700).n_pruned, 0);
}

TEST(McmcRound, CountsAtMost51Copies) {
  torch::Tensor opacities = torch::full({101}, 0.001f);
  opacities[0] = 0.9f;
  const McmcModel model = make_model(opacities);
  const DensityRound round = plan_mcmc_round(model.gaussians, {0.005, 0, 0}, 3, 600);
  const double x = model.gaussians.logit_opacities[0].item<double>();
  EXPECT_TRUE(test::within(round.edit.new_logit_opacities, torch::full({101}, shared_logit(x, 51)), 1e-6));
}

TEST(McmcRound, StaysWithinTheLimit) {
  torch::Tensor opacities = torch::full({100}, 0.5f);
  opacities.slice(0, 0, 10).fill_(0.001f);
  const McmcModel model = make_model(opacities);
  const auto round_within = [&](std::int64_t limit) {
    return plan_mcmc_round(model.gaussians, {0.005, 0.1, limit}, 3, 600);
  };
  EXPECT_EQ(round_within(0).edit.sources.size(0), 110);
  EXPECT_EQ(round_within(110).n_over_limit, 0);
  EXPECT_EQ(round_within(104).edit.sources.size(0), 104);
  EXPECT_EQ(round_within(104).n_over_limit, 6);
  const DensityRound full = round_within(50);  // there are already more than allowed
  EXPECT_EQ(full.edit.sources.size(0), 100);
  EXPECT_EQ(full.n_over_limit, 10);
  EXPECT_EQ(full.n_pruned, 10) << "dead ones still move";
}

TEST(McmcRound, WithoutLiveGaussiansChangesNothing) {
  for (const McmcModel& model : {make_model(torch::full({7}, 0.004f)), make_model(torch::full({0}, 0.5f))}) {
    const std::int64_t n = model.gaussians.size();
    const DensityRound round = plan_mcmc_round(model.gaussians, {0.005, 1, 0}, 3, 600);
    EXPECT_TRUE(test::same(round.edit.sources, torch::arange(n)));
    EXPECT_EQ(round.edit.n_kept, n);
    McmcModel edited = model;
    apply_row_edit(round.edit, edited.gaussians, edited.adam, edited.statistics);
    EXPECT_EQ(edited.gaussians.size(), n);
  }
}

TEST(McmcRound, IsTheSameForAnyNumberOfThreadsAndFollowsSeedAndIteration) {
  torch::manual_seed(4);
  const McmcModel model = make_model(torch::rand({20000}).pow(6));
  const auto sources_of = [&](std::int64_t seed, int iteration, int threads) {
    set_thread_count(threads);
    const RowEdit edit = plan_mcmc_round(model.gaussians, kRule, seed, iteration).edit;
    set_thread_count(0);
    return torch::cat({edit.sources.to(torch::kFloat64), edit.new_logit_opacities.to(torch::kFloat64),
                       edit.new_log_scales.to(torch::kFloat64).flatten()});
  };
  const torch::Tensor one = sources_of(1, 600, 1);
  EXPECT_TRUE(test::same(one, sources_of(1, 600, 2)));
  EXPECT_TRUE(test::same(one, sources_of(1, 600, 3)));
  EXPECT_FALSE(torch::equal(one.slice(0, 0, 20000), sources_of(2, 600, 1).slice(0, 0, 20000)));
  EXPECT_FALSE(torch::equal(one.slice(0, 0, 20000), sources_of(1, 700, 1).slice(0, 0, 20000)));
}

// --- Noise ---

/// Returns the covariances Sigma = R S S R^T of these Gaussians in double, computed with torch.
torch::Tensor covariances(const GaussianTensors& g) {
  const torch::Tensor stored = g.quats.to(torch::kFloat64), q = stored / stored.norm(2, 1, true);
  const auto w = q.select(1, 0), x = q.select(1, 1), y = q.select(1, 2), z = q.select(1, 3);
  const torch::Tensor r = torch::stack({1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),  //
                                        2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
                                        2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)},
                                       1)
                              .view({-1, 3, 3});
  const torch::Tensor variances = (2 * g.log_scales.to(torch::kFloat64)).exp();
  return r.matmul(torch::diag_embed(variances)).matmul(r.transpose(1, 2));
}

TEST(McmcNoise, HasMeanZeroAndTheSquareOfSigmaAsCovariance) {
  // noise = rate gate Sigma eps, so its covariance is (rate gate)^2 Sigma Sigma^T = (rate gate)^2 Sigma^2.
  constexpr std::int64_t kRows = 200000;
  constexpr double kRate = 3, kOpacity = 0.02;
  McmcModel model = make_model(torch::full({1}, kOpacity));
  GaussianTensors& g = model.gaussians;
  const torch::Tensor sigma = covariances(g)[0];
  for (torch::Tensor* tensor : g.all()) {
    std::vector<std::int64_t> sizes = tensor->sizes().vec();
    sizes[0] = kRows;
    *tensor = tensor->expand(sizes).contiguous();
  }
  g.means.zero_();
  add_mean_noise(g, kRate, /*seed=*/1, /*iteration=*/77);
  const double gate = 1 / (1 + std::exp(100 * (kOpacity - 0.005)));
  const torch::Tensor expected = std::pow(kRate * gate, 2) * sigma.matmul(sigma);
  const torch::Tensor noise = g.means.to(torch::kFloat64);
  const torch::Tensor deviation = expected.diagonal().sqrt();
  EXPECT_TRUE(test::within(noise.mean(0), torch::zeros({3}, torch::kFloat64), 5 * deviation / std::sqrt(kRows)));
  // The standard error of a covariance is at most sqrt(2 / n) times the product of the deviations.
  const torch::Tensor allowed = 5 * std::sqrt(2.0 / kRows) * deviation.outer(deviation);
  EXPECT_TRUE(test::within(noise.t().matmul(noise) / kRows, expected, allowed));
}

TEST(McmcNoise, IsLeftOutOnlyWhereItCannotChangeAFloat) {
  constexpr std::int64_t kRows = 20000;
  constexpr double kRate = 400;  // a typical --noise_lr x learning rate of the means
  torch::manual_seed(9);
  McmcModel model = make_model(torch::rand({kRows}) * 0.4);
  GaussianTensors& g = model.gaussians;
  g.means.slice(0, 0, kRows, 7).mul_(1e-3);
  g.means.slice(0, 0, kRows, 101).select(1, 2).zero_();  // any noise changes 0
  const torch::Tensor before = g.means.clone();
  const torch::Tensor opacities = torch::sigmoid(g.logit_opacities.to(torch::kFloat64));
  const torch::Tensor size = kRate / (1 + (100 * (opacities - 0.005)).exp());
  torch::Tensor eps = torch::empty({kRows, 3, 1}, torch::kFloat64);
  for (std::int64_t i = 0; i < kRows; ++i) {
    const auto normal = random_normal({1, RandomStream::kMeanNoise, 77}, static_cast<std::uint64_t>(i));
    for (std::size_t axis = 0; axis < 3; ++axis) eps[i][static_cast<std::int64_t>(axis)][0] = normal[axis];
  }
  const torch::Tensor noise = size.unsqueeze(1) * covariances(g).matmul(eps).squeeze(2);
  const torch::Tensor expected = (before.to(torch::kFloat64) + noise).to(torch::kFloat32);
  add_mean_noise(g, kRate, 1, 77);

  const torch::Tensor ulp = expected.abs() * 0x1p-23 + 1e-38;
  EXPECT_TRUE(test::within(g.means, expected, ulp));
  const torch::Tensor is_same = (g.means == before).all(1), would_be = (expected == before).all(1);
  EXPECT_TRUE(test::same(is_same, would_be)) << "noise was left out that would have changed a float, or was added";
  EXPECT_GT(is_same.sum().item<int>(), kRows / 10);
  EXPECT_GT(is_same.logical_not().sum().item<int>(), kRows / 10);
}

TEST(McmcNoise, IsTheSameForAnyNumberOfThreadsAndFollowsSeedAndIteration) {
  const auto noisy = [](std::int64_t seed, int iteration, int threads) {
    GaussianTensors g = make_model(torch::full({9000}, 0.01f)).gaussians;
    set_thread_count(threads);
    add_mean_noise(g, 1, seed, iteration);
    set_thread_count(0);
    return g.means;
  };
  const torch::Tensor one = noisy(1, 5, 1);
  EXPECT_TRUE(test::same(one, noisy(1, 5, 2)));
  EXPECT_TRUE(test::same(one, noisy(1, 5, 3)));
  EXPECT_FALSE(torch::equal(one, noisy(2, 5, 1)));
  EXPECT_FALSE(torch::equal(one, noisy(1, 6, 1)));
}

// --- The strategy ---

TEST(McmcStrategy, FollowsItsSchedule) {
  TrainConfig config;
  config.strategy = Strategy::kMcmc;
  config.densify_until_iter = 25000;
  const std::unique_ptr<DensityStrategy> strategy = make_density_strategy(config, /*extent=*/10);
  std::vector<int> rounds;
  for (int i = 1; i <= config.iterations; ++i) {
    const DensityPlan plan = strategy->plan(i);
    if (plan.densify) rounds.push_back(i);
    EXPECT_TRUE(plan.after_step) << "noise in every iteration";
    EXPECT_FALSE(plan.lower_opacities);
  }
  EXPECT_EQ(rounds.front(), 600);
  EXPECT_EQ(rounds.back(), 24900);
  EXPECT_EQ(rounds.size(), 244u);
  EXPECT_EQ(strategy->make_statistics(3, torch::kCPU).all().size(), 3u);
  config.noise_lr = 0;
  EXPECT_FALSE(make_density_strategy(config, 10)->plan(600).after_step);
}

TEST(McmcStrategy, AddsNoiseInProportionToTheLearningRateOfTheMeans) {
  TrainConfig config;
  config.strategy = Strategy::kMcmc;
  config.seed = 4;
  config.position_lr_max_steps = 1000;
  constexpr double kExtent = 2;
  const std::unique_ptr<DensityStrategy> strategy = make_density_strategy(config, kExtent);
  for (const int iteration : {1, 700}) {
    McmcModel model = make_model(torch::full({50}, 0.01f));
    GaussianTensors expected = make_model(torch::full({50}, 0.01f)).gaussians;
    strategy->after_step(iteration, model.gaussians);
    const double rate = kExtent * 0.00016 * std::pow(0.01, iteration / 1000.0);
    add_mean_noise(expected, 50000 * rate * (5 / kExtent) * (5 / kExtent), 4, iteration);
    EXPECT_TRUE(test::within(model.gaussians.means, expected.means, 1e-6 * (1 + expected.means.abs())));
    EXPECT_FALSE(torch::equal(model.gaussians.means, make_model(torch::full({50}, 0.01f)).gaussians.means));
  }
}

}  // namespace
}  // namespace b3dgs
