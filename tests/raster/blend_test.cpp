#include "raster/math/blend.h"

#include <gtest/gtest.h>

#include <cmath>
#include <vector>

#include "support/finite_difference.h"

namespace b3dgs {
namespace {

using test::gradients_agree;
using test::numeric_gradient;

TEST(Blend, EvaluatesTheExponentInBaseTwo) {
  // sigma = d^T conic d / 2 with conic (0.5, 0.1, 0.3) and d = (1.5, -2), stored times log2(e)/2.
  const double log2e = 1 / std::log(2.0);
  const SplatShape<double> splat{3.0, 7.0, std::log2(0.8), 0.25 * log2e, 0.05 * log2e, 0.15 * log2e};
  const Footprint<double> footprint = evaluate_footprint(splat, 4.5, 5.0);
  EXPECT_NEAR(footprint.conic_delta_x, 0.5 * log2e * (0.5 * 1.5 + 0.1 * -2), 1e-12);
  EXPECT_NEAR(footprint.conic_delta_y, 0.5 * log2e * (0.1 * 1.5 + 0.3 * -2), 1e-12);
  const double sigma = 0.5 * (0.5 * 2.25 + 2 * 0.1 * -3 + 0.3 * 4);
  const Alpha<double> alpha = evaluate_alpha(footprint.power);
  EXPECT_NEAR(alpha.alpha, 0.8 * std::exp(-sigma), 1e-12);
  EXPECT_FALSE(alpha.capped);
  EXPECT_TRUE(footprint.contributes);
}

TEST(Blend, SkipsBelowTheCutoff) {
  const auto contributes = [](double opacity) {
    return evaluate_footprint<double>({0, 0, std::log2(opacity), 1, 0, 1}, 0, 0).contributes;
  };
  EXPECT_TRUE(contributes(1.00001 / 255));
  EXPECT_FALSE(contributes(0.99999 / 255));
}

TEST(Blend, CapsAlpha) {
  EXPECT_NEAR(evaluate_alpha(std::log2(0.9899)).alpha, 0.9899, 1e-12);
  EXPECT_FALSE(evaluate_alpha(std::log2(0.9899)).capped);
  EXPECT_EQ(evaluate_alpha(std::log2(0.9901)).alpha, double{kAlphaMax});
  EXPECT_TRUE(evaluate_alpha(std::log2(0.9901)).capped);
}

TEST(Blend, BlendsFrontToBack) {
  PixelState<double> pixel{1, 0, 0, 0, 0};
  EXPECT_TRUE(blend_over(pixel, true, 0.25, 1.0, 0.5, 0.0, 2.0));
  EXPECT_FALSE(blend_over(pixel, false, 0.9, 1.0, 1.0, 1.0, 2.5));
  EXPECT_TRUE(blend_over(pixel, true, 0.5, 0.2, 0.4, 0.8, 3.0));
  EXPECT_DOUBLE_EQ(pixel.transmittance, 0.75 * 0.5);
  EXPECT_DOUBLE_EQ(pixel.red, 0.25 + 0.75 * 0.5 * 0.2);
  EXPECT_DOUBLE_EQ(pixel.green, 0.25 * 0.5 + 0.75 * 0.5 * 0.4);
  EXPECT_DOUBLE_EQ(pixel.blue, 0.75 * 0.5 * 0.8);
  EXPECT_DOUBLE_EQ(pixel.depth, 0.25 * 2 + 0.75 * 0.5 * 3);
}

TEST(Blend, FinishesThePixelBeforeTheSplatThatWouldSaturateIt) {
  PixelState<double> pixel{1, 0, 0, 0, 0};
  for (int i = 0; i < 3; ++i) EXPECT_TRUE(blend_over(pixel, true, 0.95, 1.0, 1.0, 1.0, 1.0));
  const double before = pixel.red;
  EXPECT_FALSE(blend_over(pixel, true, 0.95, 1.0, 1.0, 1.0, 1.0));
  EXPECT_FALSE(blend_over(pixel, true, 0.01, 1.0, 1.0, 1.0, 1.0)) << "finished means that nothing follows";
  EXPECT_EQ(pixel.red, before);
  EXPECT_NEAR(std::abs(pixel.transmittance), 1.25e-4, 1e-12);
  EXPECT_LT(pixel.transmittance, 0);
}

/// A pixel with `n` splats. Each has the parameters log2(uncapped alpha), red, green, blue, depth.
struct PixelProblem {
  std::size_t n;
  double background[3] = {0.3, 0.1, 0.8};
  double grad[5] = {0.9, -0.7, 0.4, 0.3, -0.5};  // with respect to red, green, blue, depth, alpha

  PixelState<double> blend(const std::vector<double>& x, std::vector<bool>* accepted = nullptr) const {
    PixelState<double> pixel{1, 0, 0, 0, 0};
    for (std::size_t i = 0; i < n; ++i) {
      const double* s = x.data() + 5 * i;
      const bool blended =
          blend_over(pixel, s[0] >= double{kLog2AlphaMin}, evaluate_alpha(s[0]).alpha, s[1], s[2], s[3], s[4]);
      if (accepted != nullptr) accepted->push_back(blended);
    }
    return pixel;
  }
  double loss(const std::vector<double>& x) const {
    const PixelState<double> p = blend(x);
    const double t = std::abs(p.transmittance);
    return grad[0] * (p.red + t * background[0]) + grad[1] * (p.green + t * background[1]) +
           grad[2] * (p.blue + t * background[2]) + grad[3] * p.depth + grad[4] * (1 - t);
  }
  /// Returns the gradient with respect to all parameters.
  std::vector<double> gradient(const std::vector<double>& x) const {
    std::vector<bool> accepted;
    const double t = std::abs(blend(x, &accepted).transmittance);
    const double behind = grad[0] * background[0] + grad[1] * background[1] + grad[2] * background[2] - grad[4];
    ReverseState<double> state{t, t * behind};
    std::vector<double> out(5 * n);
    for (std::size_t i = n; i-- > 0;) {
      const BlendGrad<double> g =
          blend_over_reverse(state, bool{accepted[i]}, evaluate_alpha(x[5 * i]), value(x.data() + 5 * i));
      store(g, i, out);
    }
    return out;
  }

 private:
  double value(const double* splat) const {
    return grad[0] * splat[1] + grad[1] * splat[2] + grad[2] * splat[3] + grad[3] * splat[4];
  }
  void store(const BlendGrad<double>& g, std::size_t i, std::vector<double>& out) const {
    out[5 * i] = g.log_alpha * std::log(2.0);  // q is with respect to ln(alpha)
    for (std::size_t c = 0; c < 4; ++c) out[5 * i + 1 + c] = g.weight * grad[c];
  }
};

std::vector<double> splats_with_alphas(const std::vector<double>& alphas) {
  std::vector<double> x;
  for (std::size_t i = 0; i < alphas.size(); ++i) {
    const double phase = static_cast<double>(i);
    x.insert(x.end(), {std::log2(alphas[i]), 0.5 + 0.4 * std::sin(phase), 0.5 + 0.4 * std::cos(phase),
                       0.5 - 0.3 * std::sin(2 * phase), 2 + 0.5 * phase});
  }
  return x;
}

TEST(Blend, GradientOfAPixelAgreesWithFiniteDifferences) {
  const std::vector<std::vector<double>> pixels{
      {0.6},
      {0.1, 0.5, 0.3, 0.8, 0.05, 0.4},
      {0.3, 0.003, 0.2, 0.5},           // one below the cutoff
      {0.2, 0.996, 0.4, 0.3},           // one at the cap
      {0.9, 0.8, 0.97, 0.9, 0.5, 0.4},  // the fourth ends the pixel
  };
  for (const std::vector<double>& alphas : pixels) {
    const PixelProblem problem{alphas.size()};
    const std::vector<double> x = splats_with_alphas(alphas);
    const std::vector<double> numeric =
        numeric_gradient([&](const std::vector<double>& at) { return problem.loss(at); }, x);
    EXPECT_TRUE(gradients_agree(problem.gradient(x), numeric));
  }
}

TEST(Blend, NoGradientReachesACappedSplatButThatByItsColour) {
  const PixelProblem problem{2};
  const std::vector<double> x = splats_with_alphas({0.999, 0.5});
  const std::vector<double> gradient = problem.gradient(x);
  EXPECT_EQ(gradient[0], 0);
  EXPECT_NEAR(gradient[1], 0.99 * 0.9, 1e-7);
}

}  // namespace
}  // namespace b3dgs
