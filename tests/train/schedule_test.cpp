// Tests schedules: learning rates, weights of the loss, limit on the Gaussians, view order, random numbers, outputs.

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>
#include <set>

#include "config/option_layers.h"
#include "config/output_plan.h"
#include "config/train_options.h"
#include "config/view_order.h"
#include "core/random.h"
#include "train/loss/loss.h"
#include "train/optimizer/adam.h"
#include "train/scene_limits.h"

namespace b3dgs {
namespace {

TEST(LearningRate, FallsLogLinearly) {
  EXPECT_NEAR(log_linear_rate(1e-2, 1e-4, 100, 0), 1e-2, 1e-15);
  EXPECT_NEAR(log_linear_rate(1e-2, 1e-4, 100, 50), 1e-3, 1e-15);  // the geometric mean
  EXPECT_NEAR(log_linear_rate(1e-2, 1e-4, 100, 100), 1e-4, 1e-15);
  EXPECT_NEAR(log_linear_rate(1e-2, 1e-4, 100, 1000), 1e-4, 1e-15);
}

TEST(LearningRate, WithZeroAtOneEndIsFinite) {
  EXPECT_EQ(log_linear_rate(0, 0, 100, 30), 0);
  EXPECT_NEAR(log_linear_rate(1e-2, 0, 100, 25), 0.75e-2, 1e-15);
}

TEST(LearningRate, OfMeansGrowsWithTheExtent) {
  TrainConfig config;
  const AdamRates rates = adam_rates(config, 5.0, 30000);
  EXPECT_NEAR(rates[0], 5.0 * 1.6e-6, 1e-18);
  EXPECT_EQ(rates[1], 0.005);   // scales
  EXPECT_EQ(rates[2], 0.001);   // rotations
  EXPECT_EQ(rates[3], 0.025);   // opacities
  EXPECT_EQ(rates[4], 0.0025);  // SH degree 0
  EXPECT_NEAR(rates[5], 0.000125, 1e-18);
  config.feature_rest_divisor = 10;
  EXPECT_NEAR(adam_rates(config, 5.0, 1)[5], 0.00025, 1e-18);
}

TEST(LearningRate, OfAllButTheMeansFallsToTheFinalScale) {
  TrainConfig config;
  const AdamRates constant = adam_rates(config, 5.0, 1);
  config.lr_final_scale = 0.01;
  config.lr_decay_from_iter = 10000;
  for (const auto& [iteration, scale] : {std::pair{1, 1.0}, {10000, 1.0}, {20000, 0.1}, {30000, 0.01}, {35000, 0.01}}) {
    const AdamRates rates = adam_rates(config, 5.0, iteration);
    for (std::size_t group = 1; group < rates.size(); ++group) {
      EXPECT_NEAR(rates[group], scale * constant[group], 1e-12 * constant[group]) << iteration << ", group " << group;
    }
  }
  EXPECT_EQ(adam_rates(config, 5.0, 30000)[0], adam_rates(TrainConfig{}, 5.0, 30000)[0]) << "means have their own";
  config.lr_decay_from_iter = 40000;
  EXPECT_EQ(adam_rates(config, 5.0, 29999)[1], constant[1]) << "nothing left to decay over";
  EXPECT_NEAR(adam_rates(config, 5.0, 30000)[1], 0.01 * constant[1], 1e-18);
}

TEST(Regularization, DoesNotDependOnTheUnitOfLength) {
  TrainConfig config;
  config.scale_reg = 0.5;
  config.opacity_reg = 0.25;
  // If lengths are ten times as large, so are the scales.
  EXPECT_DOUBLE_EQ(10 * regularization_weights(config, 40, 1).scale, regularization_weights(config, 4, 1).scale);
  EXPECT_EQ(regularization_weights(config, 40, 1).opacity, 0.25);
  EXPECT_EQ(regularization_weights(config, 0, 1).scale, 5) << "all cameras in one place";
}

TEST(Regularization, WeakensWithASmallLoss) {
  TrainConfig config;
  config.scale_reg = 0.5;
  config.opacity_reg = 0.25;
  for (const double loss : {kRegularizedLoss, 0.3}) EXPECT_EQ(regularization_weights(config, 5, loss).opacity, 0.25);
  const RegularizationWeights weak = regularization_weights(config, 5, kRegularizedLoss / 4);
  EXPECT_DOUBLE_EQ(weak.opacity, 0.25 / 4);
  EXPECT_DOUBLE_EQ(weak.scale, 0.5 / 4);
}

TEST(MeanNoise, DoesNotDependOnTheUnitOfLength) {
  TrainConfig config;
  config.noise_lr = 500000;
  const double at_reference = mean_noise_strength(config, 5, 100);
  EXPECT_DOUBLE_EQ(at_reference, 500000 * adam_rates(config, 5, 100)[0]);
  // If lengths are ten times as large, Sigma is 100 times as large, and the mean should move ten times as far.
  EXPECT_NEAR(mean_noise_strength(config, 50, 100), at_reference / 10, 1e-12 * at_reference);
  EXPECT_EQ(mean_noise_strength(config, 0, 100), 0) << "all cameras in one place";
}

TEST(CountLimit, FollowsThePixelsOfAPhotographAndTheNumberOfPhotographs) {
  const auto scene_of = [](std::size_t n_views) {
    Scene scene;
    scene.train.resize(n_views);
    for (View& view : scene.train) view.camera.width = 100, view.camera.height = 40;
    scene.test = scene.train;
    return scene;
  };
  Scene scene = scene_of(25);
  TrainConfig config;
  EXPECT_EQ(count_limit(config, scene), 0) << "no limit";
  config.gaussians_per_pixel = 2;
  EXPECT_EQ(count_limit(config, scene), 1200) << "4800 x 25 / 100";
  EXPECT_EQ(count_limit(config, scene_of(64)), 3932) << "4000 x 2.4 (64 / 100)^2";
  config.gaussians_per_pixel = 0.8;
  EXPECT_EQ(count_limit(config, scene), 800) << "3200 x 25 / 100";
  config.gaussians_per_pixel = 2;
  EXPECT_EQ(count_limit(config, scene_of(100)), 8000);
  EXPECT_EQ(count_limit(config, scene_of(300)), 8000) << "more photographs show no more of the scene";
  scene.train[0].camera.width = 2600;
  EXPECT_EQ(count_limit(config, scene), 2400) << "the mean of different sizes";
  config.max_gaussians = 20;
  EXPECT_EQ(count_limit(config, scene), 20) << "--max_gaussians comes first";
  config.max_gaussians = 0;
  scene.points.positions.resize(3 * 3000);
  EXPECT_EQ(count_limit(config, scene), 3000) << "no fewer than there are points";
}

TEST(DecayStart, IsNoLaterThanSoManyUsesOfEachPhotograph) {
  Scene scene;
  scene.train.resize(21);
  scene.test.resize(100);
  TrainConfig config;
  config.lr_decay_from_iter = 7500;
  EXPECT_EQ(decay_start(config, scene), 7500) << "no limit";
  config.lr_decay_from_epoch = 100;
  EXPECT_EQ(decay_start(config, scene), 7500) << "nothing decays";
  config.lr_final_scale = 0.1;
  EXPECT_EQ(decay_start(config, scene), 2100);
  config.lr_decay_from_epoch = std::numeric_limits<int>::max();
  EXPECT_EQ(decay_start(config, scene), 7500);
  config.lr_decay_from_epoch = 100;
  config = with_scene_limits(config, scene);
  EXPECT_EQ(config.lr_decay_from_iter, 2100);
  EXPECT_EQ(with_scene_limits(config, scene).lr_decay_from_iter, 2100);
}

Scene scene_of(std::size_t n_photographs) {
  Scene scene;
  scene.train.resize(n_photographs);
  scene.test.resize(100);  // test views do not count
  return scene;
}

/// Returns the config of `b3dgs train` with these options.
TrainConfig limited(const GivenOptions& given, const Scene& scene) {
  TrainConfig config = resolve_options(given).config;
  limit_epochs(config, scene.train.size(), given);
  return with_scene_limits(config, scene);
}

TEST(EpochLimit, EndsTheTrainingAfterSoManyUsesOfEachPhotograph) {
  const GivenOptions quality{{"preset", "quality"}}, budget{{"preset", "inria"}, {"strategy", "budget"}};
  const TrainConfig full = resolve_options(quality).config, config = limited(quality, scene_of(21));
  EXPECT_EQ(config.iterations, 21 * 168) << "400 x 21 / 50";
  EXPECT_EQ(config.max_epochs, 400);
  EXPECT_EQ(config.position_lr_max_steps, 3528) << "the schedule ends with the training";
  EXPECT_EQ(config.densify_until_iter, 2352);
  EXPECT_EQ(config.densify_from_iter, 59);
  EXPECT_EQ(config.densification_interval, 35);
  EXPECT_EQ(config.test_iterations, full.test_iterations) << "no part of the schedule";
  EXPECT_EQ(config.save_iterations, full.save_iterations);
  EXPECT_EQ(config.batch, full.batch);
  EXPECT_EQ(limited(budget, scene_of(21)).iterations, 21 * 168);
  EXPECT_EQ(limited({{"max_epochs", 1}}, scene_of(3)).iterations, 3);
}

TEST(EpochLimit, IsLowerWithFewPhotographsUnlessGiven) {
  for (const auto& [n, uses] : {std::pair{1, 400}, {2, 250}, {5, 100}, {8, 64}, {35, 280}, {50, 400}, {59, 400}}) {
    TrainConfig config = limited(GivenOptions::object(), scene_of(static_cast<std::size_t>(n)));
    EXPECT_EQ(config.iterations, n * uses) << n;
    EXPECT_EQ(limited({{"max_epochs", 400}}, scene_of(static_cast<std::size_t>(n))).iterations, n * 400) << n;
    EXPECT_NE(describe_epochs(config, static_cast<std::size_t>(n)).find(std::to_string(uses) + " times"),
              std::string::npos);
  }
}

TEST(EpochLimit, FollowsHowManyPhotographsShowTheSamePoint) {
  TrainConfig config = resolve_options(GivenOptions::object()).config;
  EXPECT_DOUBLE_EQ(limit_epochs(config, {200, 10.0}, GivenOptions::object()), 16000.0 / 24000) << "80 uses";
  EXPECT_EQ(config.iterations, 16000);
  EXPECT_EQ(describe_epochs(config, {200, 10.0}),
            "schedule    16,000 iterations: each photograph 80 times (--max_epochs; about 10 photographs show the same "
            "point)");
  config = resolve_options(GivenOptions::object()).config;
  EXPECT_EQ(limit_epochs(config, {60, 50.0}, GivenOptions::object()), 1);
}

TEST(TrainingPhotographs, OverlapIsOfTheViewsThatSeeAPoint) {
  Scene scene;
  EXPECT_EQ(training_photographs(scene).n, 0u);
  for (const double x : {0.0, 0.0, 0.0, 100.0}) {  // three views see the first point, and one sees the second
    View view;
    view.camera.width = view.camera.height = 100;
    view.camera.fx = view.camera.fy = 100;
    view.camera.cx = view.camera.cy = 50;
    view.camera.cam_from_world.rotation = {1, 0, 0, 0, 1, 0, 0, 0, 1};
    view.camera.cam_from_world.translation = {-x, 0, 0};
    scene.train.push_back(view);
  }
  EXPECT_EQ(training_photographs(scene).overlap, 4) << "without points: as if all saw the same";
  scene.points.positions = {0, 0, 5, 100, 0, 5, 0, 0, -5};
  EXPECT_EQ(training_photographs(scene).n, 4u);
  EXPECT_DOUBLE_EQ(training_photographs(scene).overlap, (3 * 3 + 1) / 4.0);
}

TEST(EpochLimit, LeavesTrainingsThatUsePhotographsLessOftenAsTheyAre) {
  for (const auto& [given, n] :
       {std::pair{GivenOptions{{"preset", "quality"}}, 60},
        {GivenOptions{{"preset", "inria"}, {"strategy", "budget"}}, 75},
        {GivenOptions{{"preset", "fast"}}, 28},
        {GivenOptions{{"preset", "best"}}, 75},
        {GivenOptions{{"preset", "inria"}}, 1},
        {GivenOptions{{"strategy", "default"}}, 1},
        {GivenOptions{{"strategy", "mcmc"}}, 1},
        {GivenOptions{{"max_epochs", 0}}, 1},
        {GivenOptions{{"max_epochs", std::numeric_limits<int>::max()}}, 3},
        {GivenOptions{{"iterations", 24000}}, 1},
        {GivenOptions{{"preset", "inria"}, {"iterations", 9000}, {"strategy", "budget"}}, 1}}) {
    const TrainConfig full = resolve_options(given).config;
    TrainConfig config = full;
    EXPECT_EQ(limit_epochs(config, static_cast<std::size_t>(n), given), 1);
    EXPECT_TRUE(config_differences(full, config).empty()) << given;
  }
  EXPECT_EQ(limited({{"preset", "quality"}}, scene_of(59)).iterations, 23600);
  EXPECT_EQ(limited({{"preset", "inria"}, {"strategy", "budget"}}, scene_of(74)).iterations, 29600);
  TrainConfig config;
  config.max_epochs = std::numeric_limits<int>::max();
  EXPECT_EQ(limit_epochs(config, std::numeric_limits<std::size_t>::max(), GivenOptions::object()), 1);
}

TEST(EpochLimit, AppliedAgainChangesNothing) {
  for (const std::size_t n : {1, 7, 21, 59, 60, 1000}) {
    const GivenOptions given{{"densify_until_iter", 5000}};
    const TrainConfig config = limited(given, scene_of(n));
    EXPECT_TRUE(config_differences(config, with_scene_limits(config, scene_of(n))).empty()) << n;
    TrainConfig again = config;
    EXPECT_EQ(limit_epochs(again, n, given), 1) << n;
    EXPECT_TRUE(config_differences(config, again).empty()) << n;
  }
}

TEST(EpochLimit, KeepsRoundsOfRemovalTogetherWithRoundsOfGrowth) {
  for (std::size_t n = 1; n < 60; ++n) {
    const TrainConfig config = limited({{"preset", "quality"}}, scene_of(n));
    EXPECT_EQ(config.opacity_reset_interval % config.densification_interval, 0)
        << n << " photographs: " << config.densification_interval << ", " << config.opacity_reset_interval;
  }
  const TrainConfig config = limited({{"preset", "inria"}, {"steps_scaler", 0.125}}, scene_of(100));
  EXPECT_EQ(config.densification_interval, 13);
  EXPECT_EQ(config.opacity_reset_interval, 390) << "thirty rounds, as before";
}

TEST(EpochLimit, DoesNotScaleGivenOptions) {
  const GivenOptions given{
      {"densify_until_iter", 16000}, {"lr_decay_from_epoch", 80}, {"opacity_reset_interval", 3000}};
  const TrainConfig config = limited(given, scene_of(21));
  EXPECT_EQ(config.iterations, 3528);
  EXPECT_EQ(config.densify_until_iter, 16000);
  EXPECT_EQ(config.lr_decay_from_epoch, 80);
  EXPECT_EQ(config.lr_decay_from_iter, 21 * 80);
  EXPECT_EQ(config.opacity_reset_interval, 3000) << "also a value that equals the default";
}

TEST(EpochLimit, GivenWithIterationsIsALimitToThem) {
  EXPECT_EQ(limited({{"iterations", 24000}, {"max_epochs", 600}}, scene_of(21)).iterations, 12600);
  EXPECT_EQ(limited({{"iterations", 1000}, {"max_epochs", 600}}, scene_of(21)).iterations, 1000);
  const TrainConfig original = limited({{"preset", "inria"}, {"iterations", 6000}, {"max_epochs", 100}}, scene_of(30));
  EXPECT_EQ(original.iterations, 3000);
  EXPECT_EQ(original.densify_until_iter, 7500) << "half of its schedule, which does not follow --iterations";
}

TEST(EpochLimit, IsScaledByStepsScaler) {
  const TrainConfig half = limited({{"steps_scaler", 0.5}}, scene_of(21));
  EXPECT_EQ(half.max_epochs, 200);
  EXPECT_EQ(half.iterations, 21 * 84);
  EXPECT_EQ(half.densify_until_iter, 1176);
  EXPECT_EQ(limited({{"steps_scaler", 2}, {"max_epochs", 100}}, scene_of(21)).iterations, 4200);
}

TEST(EpochLimit, ShortensASceneAsStepsScalerDoes) {
  for (const GivenOptions& given :
       {GivenOptions{{"preset", "quality"}}, GivenOptions{{"preset", "inria"}, {"strategy", "budget"}}}) {
    for (const std::size_t n : {1, 5, 21, 37}) {
      const TrainConfig config = limited(given, scene_of(n));
      GivenOptions scaled = given;
      scaled["steps_scaler"] = static_cast<double>(config.iterations) / resolve_options(given).config.iterations;
      scaled["max_epochs"] = 0;
      TrainConfig expected = limited(scaled, scene_of(n));
      EXPECT_EQ(config.lr_decay_from_iter, expected.lr_decay_from_iter) << n;
      EXPECT_LT(config.lr_decay_from_iter, config.iterations / 2) << n;
      // All options must be equal, except those of outputs and the limit itself.
      expected.max_epochs = config.max_epochs;
      expected.test_iterations = config.test_iterations;
      expected.save_iterations = config.save_iterations;
      EXPECT_EQ(config_differences(expected, config), std::vector<std::string>{}) << given << " " << n;
    }
  }
}

TEST(EpochLimit, IsDescribedWhereItEndsTheTraining) {
  EXPECT_EQ(describe_epochs(limited(GivenOptions::object(), scene_of(21)), 21),
            "schedule    3,528 iterations: each photograph 168 times (--max_epochs)");
  EXPECT_EQ(describe_epochs(limited({{"max_epochs", 1}}, scene_of(3)), 3),
            "schedule    3 iterations: each photograph 1 time (--max_epochs)");
  EXPECT_EQ(describe_epochs(limited(GivenOptions::object(), scene_of(61)), 61), "");
  EXPECT_EQ(describe_epochs(limited({{"iterations", 12600}}, scene_of(21)), 21), "");
}

TEST(ViewOrder, UsesEveryViewOnceBeforeAnyTwice) {
  ViewOrder order;
  std::set<std::vector<std::int32_t>> rounds;
  for (int round = 0; round < 5; ++round) {
    std::vector<std::int32_t> seen;
    for (int i = 0; i < 20; ++i) seen.push_back(order.next(7, 20));
    rounds.insert(seen);
    std::sort(seen.begin(), seen.end());
    for (int i = 0; i < 20; ++i) EXPECT_EQ(seen[i], i);
  }
  EXPECT_EQ(rounds.size(), 5u) << "each pass has its own order";
}

TEST(ViewOrder, ContinuesFromItsState) {
  ViewOrder order;
  for (int i = 0; i < 13; ++i) order.next(3, 8);
  ViewOrder copy{order.n_refills, order.remaining};
  for (int i = 0; i < 30; ++i) EXPECT_EQ(copy.next(3, 8), order.next(3, 8));
}

TEST(ViewOrder, TellsTheUpcomingViewsWithoutTakingThem) {
  ViewOrder order;
  for (int i = 0; i < 5; ++i) order.next(3, 8);
  const std::vector<std::int32_t> coming = order.upcoming(3, 8, 20);  // spans two refills
  ASSERT_EQ(coming.size(), 20u);
  EXPECT_EQ(order.remaining.size(), 3u);
  for (const std::int32_t view : coming) EXPECT_EQ(view, order.next(3, 8));
}

TEST(ViewOrder, FollowsTheSeed) {
  ViewOrder a, b;
  std::vector<std::int32_t> order_a, order_b;
  for (int i = 0; i < 30; ++i) {
    order_a.push_back(a.next(0, 30));
    order_b.push_back(b.next(1, 30));
  }
  EXPECT_NE(order_a, order_b);
}

TEST(ViewOrder, IsUniform) {
  std::array<int, 3> first{};
  for (int seed = 0; seed < 3000; ++seed) {
    ViewOrder order;
    ++first[order.next(seed, 3)];
  }
  for (const int count : first) EXPECT_NEAR(count, 1000, 130);  // 5 standard deviations
}

// Test vectors of the authors' Random123 library (kat_vectors, philox4x32 10).
TEST(Random, IsPhilox) {
  using Words = std::array<std::uint32_t, 4>;
  EXPECT_EQ(philox4x32({0, 0, 0, 0}, {0, 0}), (Words{0x6627e8d5, 0xe169c58d, 0xbc57ac4c, 0x9b00dbd8}));
  const std::uint32_t ones = 0xffffffff;
  EXPECT_EQ(philox4x32({ones, ones, ones, ones}, {ones, ones}),
            (Words{0x408f276d, 0x41c83b0e, 0xa20bc7c6, 0x6d5451fd}));
  EXPECT_EQ(philox4x32({0x243f6a88, 0x85a308d3, 0x13198a2e, 0x03707344}, {0xa4093822, 0x299f31d0}),
            (Words{0xd16cfe09, 0x94fdcceb, 0x5001e420, 0x24126ea1}));
}

TEST(Random, DependsOnEveryPartOfTheKey) {
  const auto base = random_bits({1, RandomStream::kSplit, 2}, 3);
  EXPECT_EQ(random_bits({1, RandomStream::kSplit, 2}, 3), base);
  EXPECT_NE(random_bits({2, RandomStream::kSplit, 2}, 3), base);
  EXPECT_NE(random_bits({1ll << 40, RandomStream::kSplit, 2}, 3), random_bits({0, RandomStream::kSplit, 2}, 3));
  EXPECT_NE(random_bits({1, RandomStream::kBackground, 2}, 3), base);
  EXPECT_NE(random_bits({1, RandomStream::kSplit, 3}, 3), base);
  EXPECT_NE(random_bits({1, RandomStream::kSplit, 2}, 4), base);
  EXPECT_NE(random_bits({1, RandomStream::kSplit, 2}, 3ull + (1ull << 32)), base);
}

TEST(Random, HasTheMomentsOfItsDistributions) {
  const int n = 40000;
  double uniform_sum = 0, normal_sum = 0, normal_squares = 0, normal_fourth = 0, neighbors = 0;
  for (int row = 0; row < n; ++row) {
    const RandomKey key{5, RandomStream::kSplit, 1};
    const auto normal = random_normal(key, row);
    for (std::size_t i = 0; i < 4; ++i) {
      const float u = random_uniform(key, row)[i];
      ASSERT_GE(u, 0);
      ASSERT_LT(u, 1);
      uniform_sum += u;
      normal_sum += normal[i];
      normal_squares += normal[i] * normal[i];
      normal_fourth += std::pow(normal[i], 4);
    }
    neighbors += normal[0] * normal[1] + normal[2] * normal[3];
  }
  // 5 standard deviations of each mean over 160 000 values
  EXPECT_NEAR(uniform_sum / (4 * n), 0.5, 0.0036);
  EXPECT_NEAR(normal_sum / (4 * n), 0, 0.0125);
  EXPECT_NEAR(normal_squares / (4 * n), 1, 0.018);
  EXPECT_NEAR(normal_fourth / (4 * n), 3, 0.125);
  EXPECT_NEAR(neighbors / (2 * n), 0, 0.018);
}

TEST(OutputPlan, WritesEverythingAfterTheLastIteration) {
  TrainConfig config;
  config.iterations = 2003;
  const OutputPlan last = output_plan(config, 2003, 2003, true);
  EXPECT_TRUE(last.log && last.evaluate && last.save && last.checkpoint);
  EXPECT_FALSE(output_plan(config, 2003, 2003, false).evaluate) << "without test views";
  const OutputPlan before = output_plan(config, 2002, 2002, true);
  EXPECT_FALSE(before.log || before.evaluate || before.save || before.checkpoint);
}

TEST(OutputPlan, LogsTheLoadAfterTheFirstIterationAndAtIntervals) {
  TrainConfig config;
  config.stats_interval = 250;
  for (const int iteration : {1, 250, 500, 30000}) EXPECT_TRUE(output_plan(config, iteration, iteration, true).load);
  for (const int iteration : {2, 249, 251}) EXPECT_FALSE(output_plan(config, iteration, iteration, true).load);
  config.stats_interval = 0;
  for (const int iteration : {1, 250}) EXPECT_FALSE(output_plan(config, iteration, iteration, true).load);
}

TEST(OutputPlan, FollowsListsAndIntervals) {
  TrainConfig config;
  config.checkpoint_iterations = {15};
  config.checkpoint_interval = 500;
  config.test_iterations = {15};
  config.save_iterations = {30};
  EXPECT_TRUE(output_plan(config, 15, 15, true).checkpoint);
  EXPECT_TRUE(output_plan(config, 15, 15, true).evaluate);
  EXPECT_TRUE(output_plan(config, 15, 15, true).log) << "an evaluation has its line";
  EXPECT_FALSE(output_plan(config, 15, 15, true).save);
  EXPECT_TRUE(output_plan(config, 30, 30, true).save);
  EXPECT_TRUE(output_plan(config, 1000, 1000, true).checkpoint);
  EXPECT_TRUE(output_plan(config, 40, 40, true).log);
}

}  // namespace
}  // namespace b3dgs
