// Which steps --skip_share skips.
#include "config/view_skips.h"

#include <gtest/gtest.h>

#include <cmath>

namespace b3dgs {
namespace {

TEST(ViewSkips, BeginAfterTheIterationAndAtFullSize) {
  TrainConfig config;
  EXPECT_FALSE(may_skip(config, 20000)) << "off by default";
  config.skip_share = 0.3;
  EXPECT_FALSE(may_skip(config, 15500));
  EXPECT_TRUE(may_skip(config, 15501));
  config.skip_from_iter = 100;
  config.coarse_scale = 4;
  config.coarse_until = 5000;
  ASSERT_EQ(coarse_scale_at(config, 1100), 2);
  ASSERT_EQ(coarse_scale_at(config, 1101), 1);
  EXPECT_FALSE(may_skip(config, 1100));
  EXPECT_TRUE(may_skip(config, 1101));
}

TEST(ViewSkips, TheMeanIsAnExponentialAverage) {
  const double losses[] = {0.5, 0.2, 0.4, 0.1, 0.3, 0.3};
  ViewLoss view;
  for (int n = 1; n <= 6; ++n) {
    double before = 0, mean = 0;  // weights 0.05 x 0.95^age; the first loss has the rest
    for (int i = 0; i < n; ++i) {
      mean += (i == 0 ? 1 : 0.05) * std::pow(0.95, n - 1 - i) * losses[i];
      if (i < n - 1) before += (i == 0 ? 1 : 0.05) * std::pow(0.95, n - 2 - i) * losses[i];
    }
    view.add(losses[n - 1]);
    EXPECT_NEAR(view.mean, mean, 1e-15) << n;
    EXPECT_EQ(view.is_low, n > 1 && losses[n - 1] <= before) << n;
  }
  view = {0.25, false};
  view.add(0.25);
  EXPECT_TRUE(view.is_low) << "equal is low enough";
}

TEST(ViewSkips, SkipAViewWhoseLossIsLowOnceInARow) {
  ViewSkips skips;
  EXPECT_FALSE(skips.skip(1, 100, 0.5)) << "no loss is known";
  skips.loss_of(1, 3).add(0.5);
  EXPECT_FALSE(skips.skip(1, 100, 0.5)) << "one loss only";
  skips.loss_of(1, 3).add(0.4);
  EXPECT_FALSE(skips.skip(0, 100, 0.5));
  EXPECT_TRUE(skips.skip(1, 100, 0.5));
  EXPECT_EQ(skips.n_skipped, 1);
  EXPECT_FALSE(skips.skip(1, 100, 0.5)) << "twice in a row";
  skips.loss_of(1, 3).add(0.6);
  EXPECT_FALSE(skips.skip(1, 100, 0.5)) << "the loss is high";
  skips.loss_of(1, 3).add(0.4);
  EXPECT_TRUE(skips.skip(1, 100, 0.5));
}

TEST(ViewSkips, KeepWithinTheShareAtAllTimes) {
  for (const double share : {0.1, 0.3, 0.5}) {
    ViewSkips skips;
    for (std::int64_t step = 1; step <= 1000; ++step) {
      const auto index = static_cast<std::int32_t>(step % 7);
      if (!skips.skip(index, step, share)) skips.loss_of(index, 7).add(1.0 / static_cast<double>(step));
      ASSERT_LE(static_cast<double>(skips.n_skipped), share * static_cast<double>(step));
    }
    EXPECT_GE(static_cast<double>(skips.n_skipped), 1000 * share - 8) << "all losses fall";
  }
}

TEST(ViewSkips, ViewsOfStepsAreThoseThatSkipWillNotSkip) {
  TrainConfig config;
  config.skip_share = 0.4;
  config.skip_from_iter = 100;
  const auto may_skip_step = [](int iteration) { return iteration != 106; };
  ViewSkips skips;
  for (const std::int32_t view : {0, 1, 2, 3}) skips.loss_of(view, 5) = {0.5, view != 2};
  const std::vector<std::int32_t> upcoming = {4, 0, 2, 1, 3, 0, 1};  // of iterations 103, 104, ...
  const std::vector<std::int32_t> found = views_of_steps(skips, config, 103, upcoming, may_skip_step);
  EXPECT_EQ(skips.n_skipped, 0) << "only a forecast";
  std::vector<std::int32_t> expected;
  for (std::size_t i = 0; i < upcoming.size(); ++i) {
    const int iteration = 103 + static_cast<int>(i);
    if (!may_skip_step(iteration) || !skips.skip(upcoming[i], iteration - 100, 0.4)) expected.push_back(upcoming[i]);
  }
  EXPECT_EQ(found, expected);
  EXPECT_EQ(found, (std::vector<std::int32_t>{4, 2, 1, 0})) << "106 may not be skipped, and 0 not twice in a row";
}

}  // namespace
}  // namespace b3dgs
