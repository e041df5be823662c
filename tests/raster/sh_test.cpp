#include "raster/math/sh.h"

#include <gtest/gtest.h>

#include <cmath>
#include <vector>

#include "raster/math/gaussian_grad.h"
#include "support/finite_difference.h"
#include "support/raster/dense_reference.h"

namespace b3dgs {
namespace {

using test::gradients_agree;
using test::numeric_gradient;

const std::vector<Vec3<double>> kOffsets{{0.3, -0.5, 2.0}, {-1.0, 0.2, 0.1}, {0.6, 0.7, -0.4}, {0, 0, 3}, {-2, -3, -1}};

/// Returns coefficients [k][channel], different in every entry.
std::vector<float> coefficients() {
  std::vector<float> values(48);
  for (std::size_t i = 0; i < values.size(); ++i) values[i] = 0.3f * std::sin(1.7f * static_cast<float>(i) + 0.4f);
  return values;
}

TEST(Sh, BasisIsThatOfTheDefinition) {
  for (const Vec3<double>& offset : kOffsets) {
    const Vec3<double> dir = (1 / std::sqrt(dot(offset, offset))) * offset;
    const torch::Tensor expected = test::dense_sh_basis(torch::tensor({{dir.x, dir.y, dir.z}}, torch::kFloat64), 3)[0];
    for (int degree = 0; degree <= 3; ++degree) {
      double basis[17];
      for (double& value : basis) value = -99;
      sh_basis(degree, dir, basis);
      const int n = (degree + 1) * (degree + 1);
      for (int k = 0; k < n; ++k) EXPECT_NEAR(basis[k], expected[k].item<double>(), 1e-14) << "basis " << k;
      EXPECT_EQ(basis[n], -99) << "degree " << degree << " must not write more than " << n;
    }
  }
}

TEST(Sh, ColourOfDegreeZeroDoesNotDependOnTheDirection) {
  const float sh0[3] = {1.0f, -1.0f, 0.25f};
  for (const Vec3<double>& offset : kOffsets) {
    const auto color = sh_color<double>(0, offset, sh0, nullptr);
    EXPECT_NEAR(color.color.x, 0.5 + 0.28209479177387814, 1e-14);
    EXPECT_NEAR(color.color.y, 0.5 - 0.28209479177387814, 1e-14);
    EXPECT_EQ(color.clamped, 0u);
  }
}

TEST(Sh, ColourIsClampedAtZeroChannelByChannel) {
  const float sh0[3] = {-2.0f, 0.5f, -1.9f};
  const auto color = sh_color<double>(0, {0, 0, 1}, sh0, nullptr);
  EXPECT_EQ(color.color.x, 0);
  EXPECT_GT(color.color.y, 0.6);
  EXPECT_EQ(color.color.z, 0);
  EXPECT_EQ(color.clamped, 0b101u);
}

TEST(Sh, GradientByTheOffsetAgreesWithFiniteDifferences) {
  const std::vector<float> c = coefficients();
  const Vec3<double> weight{0.8, -1.2, 0.5};
  for (int degree = 0; degree <= 3; ++degree) {
    for (const Vec3<double>& offset : kOffsets) {
      const auto value = [&](const std::vector<double>& x) {
        // Far above the clamp, because the constant term adds 2 to every channel.
        const float sh0[3] = {c[0] + 8, c[1] + 8, c[2] + 8};
        const auto color = sh_color<double>(degree, {x[0], x[1], x[2]}, sh0, c.data() + 3);
        return dot(weight, color.color);
      };
      const Vec3<double> grad = sh_offset_grad<double>(degree, offset, c.data() + 3, weight).offset;
      EXPECT_TRUE(
          gradients_agree({1.0, grad.x, grad.y, grad.z},
                          [&] {
                            std::vector<double> numeric = numeric_gradient(value, {offset.x, offset.y, offset.z});
                            numeric.insert(numeric.begin(), 1.0);  // degree 0 has no gradient, so compare relative to 1
                            return numeric;
                          }()))
          << "degree " << degree;
      EXPECT_NEAR(dot(grad, offset), 0, 1e-12) << "moving along the ray changes no colour";
    }
  }
}

TEST(Sh, GradientByTheCoefficientsIsTheBasis) {
  const std::vector<float> c = coefficients();
  const Vec3<double> weight{0.8, -1.2, 0.5}, offset{0.3, -0.5, 2.0};
  const Vec3<double> dir = (1 / std::sqrt(dot(offset, offset))) * offset;
  for (int degree = 0; degree <= 3; ++degree) {
    float grad_shN[48];
    for (float& value : grad_shN) value = -99;
    sh_rest_grad(degree, sh_offset_grad<double>(degree, offset, c.data() + 3, weight).dir, weight, grad_shN);
    GaussianGrad of_gaussian{};
    of_gaussian.color = {0.8f, -1.2f, 0.5f};
    double basis[16];
    sh_basis(degree, dir, basis);
    const int n = (degree + 1) * (degree + 1);
    EXPECT_FLOAT_EQ(of_gaussian.sh0().y, static_cast<float>(basis[0] * weight.y));
    for (int k = 1; k < n; ++k) EXPECT_FLOAT_EQ(grad_shN[3 * (k - 1) + 2], static_cast<float>(basis[k] * weight.z));
    EXPECT_EQ(grad_shN[3 * (n - 1)], -99) << "degree " << degree << " must not write beyond its coefficients";
  }
}

}  // namespace
}  // namespace b3dgs
