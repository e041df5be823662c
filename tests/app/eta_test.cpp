// Estimates of the remaining time, for trainings with a known time per iteration.
#include "app/terminal/eta.h"

#include <gtest/gtest.h>

#include <algorithm>

namespace b3dgs {
namespace {

/// A training in which an iteration takes constant + slope * count seconds, and the count grows by `growth` per
/// iteration from `densify_from` to `densify_until`.
struct KnownRun {
  double constant = 0.1, slope = 1e-6;
  double start_count = 10000, growth = 20;
  EtaPlan plan{10000, 500, 5000, 0};

  double count_after(int iteration) const {
    const double grown = growth * (std::min(iteration, plan.densify_until) - std::min(iteration, plan.densify_from));
    const double count = start_count + grown;
    return plan.max_gaussians > 0 ? std::min(count, static_cast<double>(plan.max_gaussians)) : count;
  }
  double elapsed_after(int iteration) const {
    double seconds = 0;
    for (int i = 1; i <= iteration; ++i) seconds += constant + slope * count_after(i);
    return seconds;
  }
  double remaining_after(int iteration) const { return elapsed_after(plan.iterations) - elapsed_after(iteration); }

  EtaHistory history_until(int iteration) const {
    EtaHistory history(plan);
    for (int i = 1; i <= iteration; ++i) {
      history.add({i, elapsed_after(i), static_cast<std::int64_t>(count_after(i))});
    }
    return history;
  }
};

TEST(Eta, NeedsTwoSamples) {
  EtaHistory history(EtaPlan{100, 0, 0, 0});
  EXPECT_FALSE(history.estimate());
  EXPECT_EQ(history.iterations_per_second(), 0);
  history.add({1, 0.5, 100});
  EXPECT_FALSE(history.estimate());
  history.add({2, 1.0, 100});
  ASSERT_TRUE(history.estimate());
  EXPECT_DOUBLE_EQ(history.estimate()->seconds, 49);  // 98 iterations of half a second
  EXPECT_DOUBLE_EQ(history.iterations_per_second(), 2);
}

TEST(Eta, IsExactForAConstantCount) {
  KnownRun run;
  run.growth = 0;
  run.plan.densify_until = 0;
  const auto eta = run.history_until(1500).estimate();
  ASSERT_TRUE(eta);
  EXPECT_FALSE(eta->is_lower_bound);
  EXPECT_NEAR(eta->seconds, run.remaining_after(1500), 1e-6 * run.remaining_after(1500));
}

TEST(Eta, KnowsThatTheCountGrowsUntilDensificationEnds) {
  KnownRun run;
  run.slope = 4e-6;  // at the end, four fifths of the time depend on the count
  const auto eta = run.history_until(2500).estimate();
  ASSERT_TRUE(eta);
  EXPECT_FALSE(eta->is_lower_bound);
  const double truth = run.remaining_after(2500);
  const double naive = 7500 * (run.constant + run.slope * run.count_after(2500));
  ASSERT_LT(naive, 0.8 * truth);  // an estimate from the current speed alone is far too low
  EXPECT_NEAR(eta->seconds, truth, 0.03 * truth);
}

TEST(Eta, DoesNotGrowBeyondTheLimit) {
  KnownRun run;
  run.slope = 4e-6;
  run.plan.max_gaussians = 60000;  // reached after iteration 3000
  const double truth = run.remaining_after(2500);
  const auto eta = run.history_until(2500).estimate();
  ASSERT_TRUE(eta);
  EXPECT_NEAR(eta->seconds, truth, 0.03 * truth);
}

TEST(Eta, IsConstantInTheCountAfterDensification) {
  KnownRun run;
  const auto eta = run.history_until(8000).estimate();
  ASSERT_TRUE(eta);
  EXPECT_NEAR(eta->seconds, run.remaining_after(8000), 1e-3 * run.remaining_after(8000));
}

TEST(Eta, IsALowerBoundBeforeGrowthWasSeen) {
  KnownRun run;
  const auto eta = run.history_until(400).estimate();
  ASSERT_TRUE(eta);
  EXPECT_TRUE(eta->is_lower_bound);
  EXPECT_LT(eta->seconds, run.remaining_after(400));
}

TEST(Eta, IsALowerBoundWhileViewsAreReduced) {
  // A second per iteration from 201 on, a quarter of it before.
  const EtaPlan plan{1000, 0, 0, 0};
  EtaHistory history(plan);
  auto add_until = [&, next = 1](int iteration) mutable {
    for (; next <= iteration; ++next) {
      history.add({next, std::min(next, 200) * 0.25 + std::max(0, next - 200), 5000, next <= 200 ? 2 : 1});
    }
  };
  add_until(200);
  ASSERT_TRUE(history.estimate());
  EXPECT_TRUE(history.estimate()->is_lower_bound);
  EXPECT_NEAR(history.estimate()->seconds, 200, 1e-9);
  EXPECT_NEAR(history.iterations_per_second(), 4, 1e-9);
  add_until(201);
  EXPECT_FALSE(history.estimate()) << "one sample of full size";
  add_until(202);
  ASSERT_TRUE(history.estimate());
  EXPECT_FALSE(history.estimate()->is_lower_bound);
  EXPECT_NEAR(history.estimate()->seconds, 798, 1e-9) << "reduced views count no more";
  EXPECT_NEAR(history.iterations_per_second(), 1, 1e-9);
}

TEST(Eta, AFallingCountIsNotExtrapolated) {
  const EtaPlan plan{1000, 0, 1000, 0};
  std::deque<EtaSample> samples;
  for (int i = 0; i <= 10; ++i) samples.push_back({20 * i, 20.0 * i, 100000 - 5000 * i});
  const auto eta = estimate_eta(samples, plan);
  ASSERT_TRUE(eta);
  EXPECT_GT(eta->seconds, 0);
  EXPECT_LE(eta->seconds, 800 * 1.01);  // one second per iteration so far, and no more with fewer Gaussians
}

TEST(Eta, IsZeroAtTheEnd) {
  KnownRun run;
  run.plan.iterations = 600;
  const auto eta = run.history_until(600).estimate();
  ASSERT_TRUE(eta);
  EXPECT_DOUBLE_EQ(eta->seconds, 0);
}

}  // namespace
}  // namespace b3dgs
