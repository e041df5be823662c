// Speed and remaining time of trainings with a known time per iteration.
#include "app/common/torch/progress.h"

#include <gtest/gtest.h>

namespace b3dgs {
namespace {

TEST(Eta, NeedsTwoIterations) {
  Eta eta(100);
  EXPECT_FALSE(eta.seconds_left());
  EXPECT_EQ(eta.iterations_per_second(), 0);
  eta.add(1, 0.5);
  eta.add(1, 7);
  EXPECT_FALSE(eta.seconds_left());
  EXPECT_EQ(eta.iterations_per_second(), 0);
  eta.add(2, 1.0);
  EXPECT_DOUBLE_EQ(eta.seconds_left().value(), 49);  // 98 iterations of half a second
  EXPECT_DOUBLE_EQ(eta.iterations_per_second(), 2);
}

TEST(Eta, IsExactAtAConstantSpeedAndZeroAtTheEnd) {
  Eta eta(1000);
  eta.add(400, 0);  // a resumed training
  for (int i = 401; i <= 1000; ++i) {
    eta.add(i, 0.25 * (i - 400));
    EXPECT_NEAR(eta.seconds_left().value(), 0.25 * (1000 - i), 1e-9);
  }
  EXPECT_EQ(eta.seconds_left(), 0);
}

TEST(Eta, FollowsAChangeOfSpeedWithoutJumps) {
  Eta eta(10000);
  for (int i = 1; i <= 1000; ++i) eta.add(i, i);
  const double before = eta.seconds_left().value();
  eta.add(1001, 1002);  // one long step
  EXPECT_NEAR(eta.seconds_left().value(), before, 0.011 * before);
  for (int i = 1002; i <= 1500; ++i) eta.add(i, 1002 + 2 * (i - 1001));
  EXPECT_NEAR(eta.seconds_left().value(), 2 * 8500, 0.01 * 2 * 8500);
  EXPECT_NEAR(eta.iterations_per_second(), 0.5, 0.01);
}

TEST(Eta, IsNeitherNegativeNorInfinite) {
  Eta eta(10);
  eta.add(0, 5);
  eta.add(4, 5);  // no time has passed
  EXPECT_EQ(eta.seconds_left(), 0);
  EXPECT_EQ(eta.iterations_per_second(), 0) << "not known";
  eta.add(5, 4);  // the clock went back
  EXPECT_EQ(eta.seconds_left(), 0);
  eta.add(12, 11);  // beyond the end
  EXPECT_EQ(eta.seconds_left(), 0);
  EXPECT_GT(eta.iterations_per_second(), 0);
}

}  // namespace
}  // namespace b3dgs
