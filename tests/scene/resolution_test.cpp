#include "scene/images/image.h"

#include <gtest/gtest.h>

#include "core/check.h"
#include "support/expect_error.h"

namespace b3dgs {
namespace {

void expect_size(ImageSize size, int width, int height) {
  EXPECT_EQ(size.width, width);
  EXPECT_EQ(size.height, height);
}

TEST(Resolution, FactorsRoundHalvesToEven) {
  expect_size(training_size({530, 946}, 2), 265, 473);
  expect_size(training_size({1242, 375}, 2), 621, 188);  // 187.5 -> 188
  expect_size(training_size({649, 389}, 2), 324, 194);   // 324.5 -> 324, 194.5 -> 194
  expect_size(training_size({1237, 822}, 4), 309, 206);  // 309.25, 205.5 -> 206
  expect_size(training_size({100, 36}, 8), 12, 4);       // 12.5 -> 12, 4.5 -> 4
  expect_size(training_size({3, 3}, 8), 1, 1);
}

TEST(Resolution, DefaultLimitsTheWidth) {
  expect_size(training_size({1600, 1200}, -1), 1600, 1200);
  expect_size(training_size({4946, 3286}, -1), 1600, 1063);  // 3286 * 1600 / 4946 = 1063.001
  expect_size(training_size({1919, 1079}, -1), 1600, 899);   // 899.6 is rounded down
  expect_size(training_size({1000, 5000}, -1), 1000, 5000);  // only the width is limited
}

TEST(Resolution, OtherNumbersAreTheWidthAndNeverEnlarge) {
  expect_size(training_size({800, 533}, 400), 400, 266);
  expect_size(training_size({800, 533}, 3), 3, 1);
  expect_size(training_size({800, 533}, 800), 800, 533);
  expect_size(training_size({800, 533}, 2000), 800, 533);
}

TEST(Resolution, DividedSizeIsThatOfAReducedFolder) {
  expect_size(divided_size({649, 389}, 2), 325, 195);  // halves up
  expect_size(divided_size({649, 389}, 1), 649, 389);
  expect_size(divided_size({2, 2}, 8), 1, 1);
}

TEST(Resolution, RejectsImplausiblySmallWidths) {
  for (const int resolution : {3, 5, 6, 7, 9, 16, 31}) {
    EXPECT_TRUE(test::fails_with<InputError>(
        {"-r " + std::to_string(resolution), std::to_string(resolution) + " px wide", "1, 2, 4 or 8"},
        [&] { check_resolution(resolution); }));
  }
  for (const int resolution : {1, 2, 4, 8, 32, 33}) EXPECT_NO_THROW(check_resolution(resolution)) << resolution;
}

TEST(Resolution, RejectsZeroAndOtherNegativeNumbers) {
  for (const int resolution : {0, -2}) {
    EXPECT_TRUE(
        test::fails_with<InputError>({"-r " + std::to_string(resolution)}, [&] { check_resolution(resolution); }));
  }
  EXPECT_NO_THROW(check_resolution(-1));
  EXPECT_NO_THROW(check_resolution(640));
}

}  // namespace
}  // namespace b3dgs
