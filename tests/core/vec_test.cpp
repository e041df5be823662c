#include "core/vec.h"

#include <gtest/gtest.h>

namespace b3dgs {
namespace {

// Rows (1 2 3), (4 5 6), (7 8 10).
constexpr Mat3<double> kMatrix{{1, 2, 3, 4, 5, 6, 7, 8, 10}};

void expect_equal(Vec3<double> found, Vec3<double> expected) {
  EXPECT_EQ(found.x, expected.x);
  EXPECT_EQ(found.y, expected.y);
  EXPECT_EQ(found.z, expected.z);
}

TEST(Vec, AddsSubtractsAndScales) {
  const Vec3<double> a{1, -2, 3}, b{0.5, 4, -1};
  expect_equal(a + b, {1.5, 2, 2});
  expect_equal(a - b, {0.5, -6, 4});
  expect_equal(2.0 * a, {2, -4, 6});
  EXPECT_EQ(dot(a, b), 0.5 - 8 - 3);
}

TEST(Vec, IndexesMatricesByRowAndColumn) {
  EXPECT_EQ(kMatrix(0, 2), 3);
  EXPECT_EQ(kMatrix(2, 0), 7);
}

TEST(Vec, MultipliesMatrixAndVector) {
  expect_equal(kMatrix * Vec3<double>{1, -1, 2}, {1 - 2 + 6, 4 - 5 + 12, 7 - 8 + 20});
  expect_equal(transpose_times(kMatrix, Vec3<double>{1, -1, 2}), {1 - 4 + 14, 2 - 5 + 16, 3 - 6 + 20});
}

}  // namespace
}  // namespace b3dgs
