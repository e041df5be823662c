// Rotation and selection of Gaussians.
#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <numeric>
#include <random>

#include "core/check.h"
#include "core/vec.h"
#include "model/edit/edit.h"
#include "raster/math/sh.h"
#include "scene/cameras/camera.h"
#include "support/expect_error.h"

namespace b3dgs {
namespace {

using test::fails_with;
using Vec = Vec3<double>;

SplatCloud random_cloud(std::size_t n, int sh_degree) {
  SplatCloud cloud;
  cloud.sh_degree = sh_degree;
  std::mt19937 random(7);
  std::uniform_real_distribution<float> uniform(-1, 1);
  const auto fill = [&](std::vector<float>& values, std::size_t count) {
    for (std::size_t i = 0; i < count; ++i) values.push_back(uniform(random));
  };
  fill(cloud.means, 3 * n);
  fill(cloud.log_scales, 3 * n);
  fill(cloud.quats, 4 * n);
  fill(cloud.logit_opacities, n);
  fill(cloud.sh0, 3 * n);
  fill(cloud.shN, 3 * n * static_cast<std::size_t>(sh_coefficient_count(sh_degree) - 1));
  return cloud;
}

const std::array<UnitQuat, 4> kRotations{
    {{1, 0, 0, 0}, {std::sqrt(0.5), 0, 0, std::sqrt(0.5)}, {0, 0.6, 0.8, 0}, {0.5, -0.5, 0.1, std::sqrt(0.49)}}};

Mat3<double> matrix_of(const UnitQuat& rotation) {
  const std::array<double, 9> values = rotation_from_quaternion(rotation);
  Mat3<double> matrix{};
  for (int i = 0; i < 9; ++i) matrix.m[i] = values[static_cast<std::size_t>(i)];
  return matrix;
}

/// Returns the view-dependent part of the red colour of Gaussian `row`.
double color_at(const SplatCloud& cloud, std::size_t row, Vec direction) {
  std::array<double, 16> basis{};
  sh_basis(cloud.sh_degree, direction, basis.data());
  const auto n_rest = static_cast<std::size_t>(sh_coefficient_count(cloud.sh_degree) - 1);
  double color = 0;
  for (std::size_t k = 0; k < n_rest; ++k) color += basis[k + 1] * cloud.shN[3 * (n_rest * row + k)];
  return color;
}

/// Returns R S S R^T of Gaussian `row`.
Mat3<double> covariance_of(const SplatCloud& cloud, std::size_t row) {
  const float* const q = &cloud.quats[4 * row];
  const Mat3<double> r = matrix_of({q[0], q[1], q[2], q[3]});
  Mat3<double> covariance{};
  for (int i = 0; i < 3; ++i) {
    for (int j = 0; j < 3; ++j) {
      for (int k = 0; k < 3; ++k) {
        const double scale = std::exp(static_cast<double>(cloud.log_scales[3 * row + static_cast<std::size_t>(k)]));
        covariance(i, j) += r(i, k) * scale * scale * r(j, k);
      }
    }
  }
  return covariance;
}

TEST(RotateSplats, ColoursAreThoseOfTheRotatedDirections) {
  for (const int degree : {1, 2, 3}) {
    const SplatCloud before = random_cloud(4, degree);
    for (const UnitQuat& rotation : kRotations) {
      SplatCloud after = before;
      rotate_splats(rotation, after);
      const Mat3<double> matrix = matrix_of(rotation);
      for (int i = 0; i < 50; ++i) {
        const double z = -0.98 + 0.04 * i, angle = 2.4 * i, radius = std::sqrt(1 - z * z);
        const Vec direction{radius * std::cos(angle), radius * std::sin(angle), z};
        for (std::size_t row = 0; row < 4; ++row) {
          ASSERT_NEAR(color_at(after, row, matrix * direction), color_at(before, row, direction), 1e-6)
              << "degree " << degree << ", direction " << i;
        }
      }
      EXPECT_EQ(after.sh0, before.sh0);
    }
  }
}

TEST(RotateSplats, TheMatrixOfShIsARotationOfEachDegree) {
  for (const UnitQuat& rotation : kRotations) {
    const std::array<double, 225> m = sh_rotation(rotation);
    const auto degree_of = [](std::size_t i) { return i < 3 ? 1 : i < 8 ? 2 : 3; };
    for (std::size_t i = 0; i < 15; ++i) {
      for (std::size_t j = 0; j < 15; ++j) {
        if (degree_of(i) != degree_of(j)) {
          EXPECT_NEAR(m[15 * i + j], 0, 1e-14);
        }
        double dot = 0;
        for (std::size_t k = 0; k < 15; ++k) dot += m[15 * i + k] * m[15 * j + k];
        EXPECT_NEAR(dot, i == j ? 1 : 0, 1e-13);
      }
    }
  }
}

TEST(RotateSplats, TurnsMeansAndCovariances) {
  const SplatCloud before = random_cloud(5, 0);
  for (const UnitQuat& rotation : kRotations) {
    SplatCloud after = before;
    rotate_splats(rotation, after);
    const Mat3<double> m = matrix_of(rotation);
    for (std::size_t row = 0; row < 5; ++row) {
      const float* const b = &before.means[3 * row];
      const Vec moved = m * Vec{b[0], b[1], b[2]};
      EXPECT_NEAR(after.means[3 * row], moved.x, 1e-6);
      EXPECT_NEAR(after.means[3 * row + 1], moved.y, 1e-6);
      EXPECT_NEAR(after.means[3 * row + 2], moved.z, 1e-6);
      const Mat3<double> was = covariance_of(before, row), is = covariance_of(after, row);
      for (int i = 0; i < 3; ++i) {
        for (int j = 0; j < 3; ++j) {
          double expected = 0;
          for (int k = 0; k < 3; ++k) {
            for (int l = 0; l < 3; ++l) expected += m(i, k) * was(k, l) * m(j, l);
          }
          EXPECT_NEAR(is(i, j), expected, 1e-5);
        }
      }
    }
  }
}

TEST(RotateSplats, BackAgainGivesTheSame) {
  const SplatCloud before = random_cloud(20, 3);
  SplatCloud after = before;
  rotate_splats(kRotations[3], after);
  EXPECT_GT(std::abs(after.shN[0] - before.shN[0]), 0.01);
  rotate_splats(inverse(kRotations[3]), after);
  for (std::size_t i = 0; i < before.shN.size(); ++i) ASSERT_NEAR(after.shN[i], before.shN[i], 1e-6);
  for (std::size_t i = 0; i < before.means.size(); ++i) ASSERT_NEAR(after.means[i], before.means[i], 1e-6);
}

TEST(RotationBetween, TurnsOneDirectionIntoTheOther) {
  const std::array<std::array<double, 3>, 5> directions{
      {{0, 0, 2}, {0, -1, 0}, {1, 0, 0}, {-3, 0, 0}, {0.3, -0.4, 0.5}}};
  for (const auto& from : directions) {
    for (const auto& to : directions) {
      const UnitQuat rotation = rotation_between(from, to);
      const double from_length = std::hypot(from[0], from[1], from[2]), to_length = std::hypot(to[0], to[1], to[2]);
      const Vec turned = matrix_of(rotation) * ((1 / from_length) * Vec{from[0], from[1], from[2]});
      EXPECT_NEAR(turned.x, to[0] / to_length, 1e-7);
      EXPECT_NEAR(turned.y, to[1] / to_length, 1e-7);
      EXPECT_NEAR(turned.z, to[2] / to_length, 1e-7);
    }
  }
}

TEST(ScaleSplats, MultipliesWorldCoordinatesAndSizes) {
  SplatCloud cloud = random_cloud(5, 1);
  cloud.frame = {{10, -20, 30}, 0.5};
  const SplatCloud before = cloud;
  scale_splats(4, cloud);
  for (std::size_t row = 0; row < 5; ++row) {
    const auto was = before.frame.to_world(&before.means[3 * row]), is = cloud.frame.to_world(&cloud.means[3 * row]);
    for (std::size_t axis = 0; axis < 3; ++axis) EXPECT_NEAR(is[axis], 4 * was[axis], 1e-12);
  }
  EXPECT_EQ(cloud.frame.unit, 2) << "of the sizes, too";
  EXPECT_EQ(cloud.log_scales, before.log_scales);
}

TEST(ParseScale, IsAFactorOrTwoPointsAndTheirDistance) {
  EXPECT_EQ(parse_scale("2.5"), 2.5);
  EXPECT_DOUBLE_EQ(parse_scale("1,2,3, 1,5,-1, 12.5"), 2.5) << "they are 5 apart";
  for (const char* text : {"", "0", "-1", "nan", "1,2", "1,2,3,4,5,6", "1,2,3,1,2,3,5", "1,2,3,4,5,6,0",
                           "1,2,3,4,5,6,-7", "1,2,3,4,5,6,7,8"}) {
    EXPECT_TRUE(fails_with<InputError>({"--scale", "expected a factor above 0, or two different points"}, [&] {
      parse_scale(text);
    })) << text;
  }
  EXPECT_TRUE(fails_with<InputError>({"--scale two", "\"two\""}, [] { parse_scale("two"); }));
}

TEST(MoveToUtm, MovesMeansAndTurnsOrientations) {
  Georeference place;
  place.easting = 500000;
  place.northing = 5000000;
  place.height = 200;
  place.convergence = 30;
  place.grid_scale = 0.9996;
  SplatCloud cloud = random_cloud(4, 2);
  cloud.frame = {{300, -200, 10}, 2};
  const SplatCloud before = cloud;
  move_to_utm(place, cloud);
  EXPECT_TRUE(cloud.frame.is_far()) << "a PLY has double precision";
  const double angle = 30 * kDegree;
  const Mat3<double> turn{std::cos(angle), -std::sin(angle), 0, std::sin(angle), std::cos(angle), 0, 0, 0, 1};
  for (std::size_t row = 0; row < 4; ++row) {
    const auto was = before.frame.to_world(&before.means[3 * row]), is = cloud.frame.to_world(&cloud.means[3 * row]);
    const Vec turned = turn * Vec{was[0], was[1], was[2]};
    EXPECT_NEAR(is[0], 500000 + 0.9996 * turned.x, 1e-3);
    EXPECT_NEAR(is[1], 5000000 + 0.9996 * turned.y, 1e-3);
    EXPECT_NEAR(is[2], 200 + was[2], 0.02) << "the Earth falls by 1 cm within 400 m";
    const Mat3<double> covariance = covariance_of(cloud, row), expected = covariance_of(before, row);
    const Vec direction{0.6, 0, 0.8};
    EXPECT_NEAR(dot(turn * direction, covariance * (turn * direction)), dot(direction, expected * direction), 1e-5);
    EXPECT_NEAR(color_at(cloud, row, turn * direction), color_at(before, row, direction), 1e-5);
  }
}

TEST(KeepIf, KeepsAllValuesOfTheRows) {
  const SplatCloud before = random_cloud(7, 2);
  SplatCloud after = before;
  EXPECT_EQ(keep_if([](std::size_t row) { return row % 3 == 1; }, after), 5);
  ASSERT_EQ(after.size(), 2);
  for (std::size_t i = 0; i < 2; ++i) {
    const std::size_t row = 3 * i + 1;
    for (std::size_t k = 0; k < 3; ++k) EXPECT_EQ(after.means[3 * i + k], before.means[3 * row + k]);
    for (std::size_t k = 0; k < 4; ++k) EXPECT_EQ(after.quats[4 * i + k], before.quats[4 * row + k]);
    for (std::size_t k = 0; k < 24; ++k) EXPECT_EQ(after.shN[24 * i + k], before.shN[24 * row + k]);
    EXPECT_EQ(after.logit_opacities[i], before.logit_opacities[row]);
  }
  EXPECT_EQ(after.shN.size(), 48u);
}

TEST(KeepHighest, KeepsTheOrderAndTheFirstOfEqualScores) {
  SplatCloud cloud = random_cloud(5, 0);
  const std::vector<float> opacities = cloud.logit_opacities;
  EXPECT_EQ(keep_highest({1, 5, 2, 5, 2}, 3, cloud), 2);
  EXPECT_EQ(cloud.logit_opacities, (std::vector<float>{opacities[1], opacities[2], opacities[3]}));
  EXPECT_EQ(keep_highest({1, 2, 3}, 9, cloud), 0);
  EXPECT_EQ(cloud.size(), 3);
}

TEST(OpacityTimesArea, IgnoresTheShortestAxis) {
  SplatCloud cloud = random_cloud(2, 0);
  cloud.logit_opacities = {0, 0};
  cloud.log_scales = {std::log(2.0f), std::log(3.0f), -9, -2, std::log(6.0f), 0};
  const std::vector<double> scores = opacity_times_area(cloud);
  EXPECT_NEAR(scores[0], 0.5 * 6, 1e-6);
  EXPECT_NEAR(scores[1], 0.5 * 6, 1e-6);
}

TEST(LimitShDegree, DropsCoefficients) {
  const SplatCloud before = random_cloud(3, 3);
  SplatCloud after = before;
  limit_sh_degree(1, after);
  EXPECT_EQ(after.sh_degree, 1);
  ASSERT_EQ(after.shN.size(), 27u);
  for (std::size_t row = 0; row < 3; ++row) {
    for (std::size_t k = 0; k < 9; ++k) EXPECT_EQ(after.shN[9 * row + k], before.shN[45 * row + k]);
  }
  limit_sh_degree(3, after);
  EXPECT_EQ(after.sh_degree, 1);
}

}  // namespace
}  // namespace b3dgs
