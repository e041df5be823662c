// Tests the two filters of anti-aliasing on one Gaussian, and their gradients by finite differences, in double.
#include "raster/math/antialiasing.h"

#include <gtest/gtest.h>

#include <cmath>
#include <vector>

#include "raster/math/covariance.h"
#include "support/finite_difference.h"

namespace b3dgs::test {
namespace {

TEST(Antialiasing, SmoothingKeepsTheIntegralOfTheGaussian) {
  const Vec3<double> log_scales{-4.0, -6.5, -1.0};
  const double filter = 0.01;
  const Smoothed<double> smoothed = smooth(log_scales, filter);
  const auto variance = [&](double log_scale) { return std::exp(2 * log_scale) + filter * filter; };
  EXPECT_NEAR(std::exp(2 * smoothed.log_scales.x), variance(log_scales.x), 1e-15);
  EXPECT_NEAR(std::exp(2 * smoothed.log_scales.y), variance(log_scales.y), 1e-15);
  EXPECT_NEAR(std::exp(2 * smoothed.log_scales.z), variance(log_scales.z), 1e-12);
  const double volume_before = log_scales.x + log_scales.y + log_scales.z;
  const double volume_after = smoothed.log_scales.x + smoothed.log_scales.y + smoothed.log_scales.z;
  EXPECT_NEAR(smoothed.log_opacity_ratio + volume_after, volume_before, 1e-12);
}

TEST(Antialiasing, WithoutAFilterNothingChanges) {
  const Smoothed<float> smoothed = smooth(Vec3f{-4.0f, -6.5f, -1.0f}, 0.0f);
  EXPECT_EQ(smoothed.log_scales.x, -4.0f);
  EXPECT_EQ(smoothed.log_scales.y, -6.5f);
  EXPECT_EQ(smoothed.log_scales.z, -1.0f);
  EXPECT_EQ(smoothed.log_opacity_ratio, 0.0f);
}

TEST(Antialiasing, ScalesThatVanishStayFinite) {
  const Smoothed<float> smoothed = smooth(Vec3f{-100.0f, -1e4f, -3.0f}, 0.01f);
  for (const float value : {smoothed.log_scales.x, smoothed.log_scales.y, smoothed.log_scales.z, smoothed.share.x,
                            smoothed.share.y, smoothed.share.z, smoothed.log_opacity_ratio}) {
    EXPECT_TRUE(std::isfinite(value)) << value;
  }
  EXPECT_LT(smoothed.log_opacity_ratio, -60);
}

TEST(Antialiasing, SmoothingGradientAgreesWithFiniteDifferences) {
  const double filter = 0.02;
  const std::vector<double> x{-4.0, -3.9, -2.0};
  const auto weighted = [&](const std::vector<double>& at) {
    const Smoothed<double> s = smooth(Vec3<double>{at[0], at[1], at[2]}, filter);
    return 0.7 * s.log_scales.x - 1.3 * s.log_scales.y + 0.4 * s.log_scales.z + 2.1 * s.log_opacity_ratio;
  };
  const Smoothed<double> s = smooth(Vec3<double>{x[0], x[1], x[2]}, filter);
  const std::vector<double> gradient{0.7 * s.share.x + 2.1 * (1 - s.share.x), -1.3 * s.share.y + 2.1 * (1 - s.share.y),
                                     0.4 * s.share.z + 2.1 * (1 - s.share.z)};
  EXPECT_TRUE(gradients_agree(gradient, numeric_gradient(weighted, x)));
}

PinholeView plain_view() {
  PinholeView view{};
  view.rotation = {{1, 0, 0, 0, 1, 0, 0, 0, 1}};
  view.fx = 410;
  view.fy = 395;
  view.cx = 64;
  view.cy = 48;
  view.width = 128;
  view.height = 96;
  return view;
}

/// Returns the log of the opacity factor, given the rows of the projected shape.
double log_factor(const std::vector<double>& spread) {
  const Vec3<double> a{spread[0], spread[1], spread[2]}, b{spread[3], spread[4], spread[5]};
  const double sharp = dot(a, a) * dot(b, b) - dot(a, b) * dot(a, b), blur = kCovarianceBlur;
  const double det = (dot(a, a) + blur) * (dot(b, b) + blur) - dot(a, b) * dot(a, b);
  return 0.5 * std::log(sharp / det);
}

TEST(Antialiasing, BlurRatioAndItsGradientAgreeWithTheDefinition) {
  const auto view = make_view_transform<double>(plain_view());
  const Shape<double> shape = make_shape<double>({-5.5, -4.8, -6.0}, {0.5, -0.8, 0.3, 0.4});
  const Projection<double> p = project_gaussian<double>(view, Pinhole{}, {0.1, -0.05, 1.7}, shape.factor);
  const std::vector<double> spread{p.spread_x.x, p.spread_x.y, p.spread_x.z, p.spread_y.x, p.spread_y.y, p.spread_y.z};
  EXPECT_NEAR(std::log(blur_ratio(p)) / 2, log_factor(spread), 1e-10);
  ASSERT_LT(blur_ratio(p), 0.9) << "the blur hardly matters here";
  constexpr double kQ = -1.7;
  const SpreadGrad<double> grad = blur_ratio_backward(p, kQ);
  const auto value = [&](const std::vector<double>& at) { return kQ * log_factor(at); };
  EXPECT_TRUE(
      gradients_agree({grad.x.x, grad.x.y, grad.x.z, grad.y.x, grad.y.y, grad.y.z}, numeric_gradient(value, spread)));
}

TEST(Antialiasing, NeedlesHaveTheSmallestFactorAndNoGradient) {
  const auto view = make_view_transform<double>(plain_view());
  const Shape<double> shape = make_shape<double>({-20, -20, -3}, {0, 0.7, 0.7, 0});
  const Projection<double> p = project_gaussian<double>(view, Pinhole{}, {0, 0, 2}, shape.factor);
  EXPECT_EQ(blur_ratio(p), double{kMinBlurRatio});
  const SpreadGrad<double> grad = blur_ratio_backward(p, 3.0);
  EXPECT_EQ(grad.x.x, 0);
  EXPECT_EQ(grad.y.z, 0);
}

}  // namespace
}  // namespace b3dgs::test
