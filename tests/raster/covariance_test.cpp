#include "raster/math/covariance.h"

#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <vector>

#include "support/finite_difference.h"

namespace b3dgs {
namespace {

using test::gradients_agree;
using test::numeric_gradient;

const std::vector<std::vector<double>> kShapes{
    // three log scales, then w x y z
    {0.1, -0.4, 0.3, 1, 0, 0, 0},         {-2.0, -1.0, 0.5, 0.3, -0.7, 0.2, 0.9},
    {0.2, 0.2, 0.2, -0.5, 0.5, 0.5, 0.5}, {-6.0, 1.5, -3.0, 0.01, 0.02, -0.03, 0.015},
    {0.5, -0.2, 0.1, 120, -340, 75, 260},
};

Shape<double> shape_of(const std::vector<double>& x) {
  return make_shape<double>({x[0], x[1], x[2]}, {x[3], x[4], x[5], x[6]});
}

/// Returns M M^T.
std::array<double, 9> covariance_of(const Shape<double>& shape) {
  std::array<double, 9> covariance{};
  for (int i = 0; i < 3; ++i) {
    for (int j = 0; j < 3; ++j) {
      for (int k = 0; k < 3; ++k) covariance[3 * i + j] += shape.factor(i, k) * shape.factor(j, k);
    }
  }
  return covariance;
}

TEST(Covariance, IsDiagonalWithoutRotation) {
  const auto covariance = covariance_of(make_shape<double>({std::log(2), std::log(3), std::log(0.5)}, {1, 0, 0, 0}));
  const std::array<double, 9> expected{4, 0, 0, 0, 9, 0, 0, 0, 0.25};
  for (int i = 0; i < 9; ++i) EXPECT_NEAR(covariance[i], expected[i], 1e-14);
}

TEST(Covariance, TurnsByTheRightHandRule) {
  // A right angle about +z takes +x to +y, so the long first axis is then along y.
  const auto about_z = covariance_of(make_shape<double>({std::log(2), 0, 0}, {1, 0, 0, 1}));
  EXPECT_NEAR(about_z[0], 1, 1e-14);
  EXPECT_NEAR(about_z[4], 4, 1e-14);
  // 45 degrees about +x take +y half way to +z.
  const double half = M_PI / 8;
  const auto about_x = covariance_of(make_shape<double>({0, std::log(3), 0}, {std::cos(half), std::sin(half), 0, 0}));
  EXPECT_NEAR(about_x[4], 5, 1e-14);
  EXPECT_NEAR(about_x[8], 5, 1e-14);
  EXPECT_NEAR(about_x[5], 4, 1e-14);  // (9 - 1) / 2, positive because along the long axis, y and z have the same sign
}

TEST(Covariance, DoesNotDependOnTheQuaternionsLength) {
  const auto unit = covariance_of(make_shape<double>({0.3, -1, 0.2}, {0.1, 0.7, -0.5, 0.5}));
  const auto longer = covariance_of(make_shape<double>({0.3, -1, 0.2}, {1e3, 7e3, -5e3, 5e3}));
  const auto negated = covariance_of(make_shape<double>({0.3, -1, 0.2}, {-0.1, -0.7, 0.5, -0.5}));
  for (int i = 0; i < 9; ++i) {
    EXPECT_NEAR(longer[i], unit[i], 1e-14);
    EXPECT_NEAR(negated[i], unit[i], 1e-14);
  }
}

TEST(Covariance, GradientAgreesWithFiniteDifferences) {
  const Mat3<double> weights{{0.7, -1.1, 0.4, 1.3, 0.2, -0.6, -0.9, 0.8, 0.5}};
  for (const std::vector<double>& x : kShapes) {
    // The loss is linear in M, and the columns are weighted so that the smallest scale matters as much as the largest.
    Mat3<double> grad_factor = weights;
    for (int i = 0; i < 9; ++i) grad_factor.m[i] *= std::exp(-x[static_cast<std::size_t>(i % 3)]);
    const auto loss = [&](const std::vector<double>& at) {
      const Shape<double> shape = shape_of(at);
      double sum = 0;
      for (int i = 0; i < 9; ++i) sum += grad_factor.m[i] * shape.factor.m[i];
      return sum;
    };
    const ShapeGrad<double> grad = shape_backward(shape_of(x), grad_factor);
    const std::vector<double> numeric_scales = [&] {
      const auto of_scales = [&](const std::vector<double>& s) {
        return loss({s[0], s[1], s[2], x[3], x[4], x[5], x[6]});
      };
      return numeric_gradient(of_scales, {x[0], x[1], x[2]});
    }();
    EXPECT_TRUE(gradients_agree({grad.log_scales.x, grad.log_scales.y, grad.log_scales.z}, numeric_scales));

    // Use steps relative to the quaternion's length.
    const double length = std::sqrt(x[3] * x[3] + x[4] * x[4] + x[5] * x[5] + x[6] * x[6]);
    const auto of_quat = [&](const std::vector<double>& q) {
      return loss({x[0], x[1], x[2], q[0] * length, q[1] * length, q[2] * length, q[3] * length});
    };
    std::vector<double> numeric_quat =
        numeric_gradient(of_quat, {x[3] / length, x[4] / length, x[5] / length, x[6] / length});
    for (double& g : numeric_quat) g /= length;
    EXPECT_TRUE(gradients_agree({grad.quat.x, grad.quat.y, grad.quat.z, grad.quat.w}, numeric_quat));
  }
}

}  // namespace
}  // namespace b3dgs
