// Tests the scale at which views are trained.
#include "config/coarse_schedule.h"

#include <gtest/gtest.h>

#include <cmath>

namespace b3dgs {
namespace {

TrainConfig coarse(int scale, int until, int interval) {
  TrainConfig config;
  config.coarse_scale = scale;
  config.coarse_until = until;
  config.densification_interval = interval;
  return config;
}

TEST(CoarseSchedule, IsOffByDefault) {
  for (const int iteration : {1, 100, 101, 14999, 30000}) EXPECT_EQ(coarse_scale_at(TrainConfig{}, iteration), 1);
}

TEST(CoarseSchedule, ShareOfPixelsGrowsLinearlyToFullSize) {
  for (const int largest : {2, 3, 4, 8}) {
    for (const int until : {1, 999, 5000, 2000000000}) {
      const TrainConfig config = coarse(largest, until, 100);
      EXPECT_EQ(coarse_scale_at(config, 1), largest);
      for (const int iteration : {1, 2, 99, 100, 101, 350, 999, 1000, 1101, 3333, 4901, 1000000001}) {
        const double done = 100.0 * static_cast<double>((iteration - 1) / 100) / until;
        const double share = 1.0 / (largest * largest) + (1 - 1.0 / (largest * largest)) * done;
        const double exact = done >= 1 ? 1 : std::sqrt(1 / share);
        const int scale = coarse_scale_at(config, iteration);
        EXPECT_LE(scale, exact + 1e-9) << largest << " " << until << " " << iteration;
        EXPECT_GT(scale + 1, exact - 1e-9) << largest << " " << until << " " << iteration;
      }
    }
  }
}

TEST(CoarseSchedule, ChangesOnlyAfterRoundsAndNeverGrows) {
  const TrainConfig config = coarse(8, 5000, 70);
  int last = 8, n_changes = 0;
  for (int iteration = 1; iteration <= 6000; ++iteration) {
    const int scale = coarse_scale_at(config, iteration);
    EXPECT_LE(scale, last);
    EXPECT_TRUE(scale == last || (iteration - 1) % 70 == 0) << iteration;
    n_changes += scale != last;
    last = scale;
  }
  EXPECT_GE(n_changes, 4);
  EXPECT_EQ(last, 1);
}

TEST(CoarseSchedule, SmallViewsKeepSixteenPixels) {
  EXPECT_EQ(coarse_scale_of(4, 640, 480), 4);
  EXPECT_EQ(coarse_scale_of(8, 640, 100), 6);
  EXPECT_EQ(coarse_scale_of(8, 31, 400), 1);
  EXPECT_EQ(coarse_scale_of(8, 5, 5), 1);
  EXPECT_EQ(coarse_scale_of(1, 640, 480), 1);
}

}  // namespace
}  // namespace b3dgs
