#include "app/georeference/fit_to_gps.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <random>

#include "support/expect_error.h"

namespace b3dgs {
namespace {

using Point = std::array<double, 3>;

/// A camera frame that is 4 m per unit, rolled, and elsewhere.
Similarity true_similarity() {
  return {4, rotation_from_quaternion({0.3, 0.7, -0.4, 0.5}), {120, -35, 12}};
}

/// Returns the coordinates in the frame of the cameras of a point in metres.
Point before(const Point& at) {
  const Similarity to = true_similarity();
  const Point moved{at[0] - to.translation[0], at[1] - to.translation[1], at[2] - to.translation[2]};
  Point turned = rotated_back(to.rotation, moved);
  for (double& value : turned) value /= to.scale;
  return turned;
}

class FitToGps : public testing::Test {
 protected:
  /// Adds n cameras in a block of width x depth x height m, with positions of normal errors.
  void add(std::size_t n, const Point& size, double error) {
    std::normal_distribution<double> normal(0, error);
    std::uniform_real_distribution<double> uniform(-0.5, 0.5);
    for (std::size_t i = 0; i < n; ++i) {
      Point at{size[0] * uniform(random_), size[1] * uniform(random_), size[2] * uniform(random_)};
      input_.centers.push_back(before(at));
      for (double& value : at) value += error > 0 ? normal(random_) : 0;
      input_.positions.push_back(at);
    }
  }
  void set_up() { input_.up = rotated_back(true_similarity().rotation, {0, 0, 1}); }
  /// Returns the largest distance between where a fit and the truth put a camera, m.
  double largest_error(const GpsFit& fit) const {
    double largest = 0;
    for (const Point& center : input_.centers) {
      largest = std::max(largest, distance(fit.to_earth(center), true_similarity()(center)));
    }
    return largest;
  }
  testing::AssertionResult refuses(const std::string& part) {
    std::string why_not;
    if (fit_to_gps(input_, why_not)) return testing::AssertionFailure() << "it fits";
    if (test::contains(why_not, part)) return testing::AssertionSuccess();
    return testing::AssertionFailure() << "\"" << part << "\" is not in: " << why_not;
  }

  std::mt19937 random_{7};
  GpsFitInput input_;
  std::string why_not_;
};

TEST_F(FitToGps, ExactPositionsGiveTheSimilarity) {
  add(8, {80, 60, 10}, 0);
  const auto fit = fit_to_gps(input_, why_not_);
  ASSERT_TRUE(fit) << why_not_;
  EXPECT_FALSE(fit->is_level);
  EXPECT_EQ(fit->kept.size(), 8u);
  EXPECT_LT(largest_error(*fit), 1e-9);
  EXPECT_NEAR(fit->to_earth.scale, 4, 1e-12);
}

TEST_F(FitToGps, TwoGrossErrorsAreLeftOut) {
  add(20, {100, 80, 15}, 0.3);
  input_.positions[4][0] += 60;
  input_.positions[11][2] -= 2500;
  const auto fit = fit_to_gps(input_, why_not_);
  ASSERT_TRUE(fit) << why_not_;
  EXPECT_EQ(std::count(fit->kept.begin(), fit->kept.end(), 4u), 0);
  EXPECT_EQ(std::count(fit->kept.begin(), fit->kept.end(), 11u), 0);
  EXPECT_GE(fit->kept.size(), 16u);
  EXPECT_LT(largest_error(*fit), 0.6) << "of 0.3 m of noise";
  EXPECT_NEAR(fit->to_earth.scale, 4, 0.02);
  EXPECT_GT(fit->median_residual, 0.1);
  EXPECT_LT(fit->largest_residual, 2);
  const auto again = fit_to_gps(input_, why_not_);
  EXPECT_EQ(again->to_earth.translation, fit->to_earth.translation) << "the random numbers are fixed";
}

TEST_F(FitToGps, FortyPercentMayBeWrong) {
  add(30, {100, 80, 15}, 0.2);
  std::uniform_real_distribution<double> uniform(-300, 300);
  for (std::size_t i = 0; i < 12; ++i) input_.positions[i] = {uniform(random_), uniform(random_), uniform(random_)};
  const auto fit = fit_to_gps(input_, why_not_);
  ASSERT_TRUE(fit) << why_not_;
  EXPECT_LT(largest_error(*fit), 0.6);
  EXPECT_EQ(std::count_if(fit->kept.begin(), fit->kept.end(), [](std::size_t i) { return i < 12; }), 0);
}

TEST_F(FitToGps, WithoutHeightsUpIsThatOfTheCameras) {
  add(15, {100, 80, 0}, 0.2);
  for (Point& position : input_.positions) position[2] = std::nan("");
  input_.has_heights = false;
  EXPECT_TRUE(refuses("no height"));
  set_up();
  const auto fit = fit_to_gps(input_, why_not_);
  ASSERT_TRUE(fit) << why_not_;
  EXPECT_TRUE(fit->is_level);
  for (const Point& center : input_.centers) {
    const Point at = fit->to_earth(center), truth = true_similarity()(center);
    EXPECT_NEAR(at[0], truth[0], 0.5);
    EXPECT_NEAR(at[1], truth[1], 0.5);
  }
}

TEST_F(FitToGps, CamerasInALineNeedUp) {
  add(15, {200, 0.1, 0.1}, 0.2);
  EXPECT_TRUE(refuses("stand in a line"));
  set_up();
  const auto fit = fit_to_gps(input_, why_not_);
  ASSERT_TRUE(fit) << why_not_;
  EXPECT_TRUE(fit->is_level);
  EXPECT_LT(largest_error(*fit), 0.6);
  const Point beside = before({0, 0, 50});  // shows a roll about the line
  EXPECT_LT(distance(fit->to_earth(beside), {0, 0, 50}), 0.6);
}

TEST_F(FitToGps, AWrongUpOfCamerasInALineIsNotUsed) {
  add(15, {200, 0.1, 0.1}, 0.2);
  input_.up = rotated_back(true_similarity().rotation, {1, 0, 0});  // all cameras look down and fly ahead
  EXPECT_TRUE(refuses("contradict"));
}

TEST_F(FitToGps, PositionsOfOtherCamerasContradict) {
  add(20, {100, 80, 15}, 0);
  std::shuffle(input_.positions.begin(), input_.positions.end(), random_);
  set_up();
  EXPECT_TRUE(refuses("contradict"));
}

TEST_F(FitToGps, OnePlaceForAllDeterminesNothing) {
  add(10, {100, 80, 15}, 0);
  for (Point& position : input_.positions) position = {3, 4, 5};
  set_up();
  EXPECT_TRUE(refuses("all GPS positions are the same"));
}

TEST_F(FitToGps, ThreePositionsAreTooFew) {
  add(3, {100, 80, 15}, 0);
  EXPECT_TRUE(refuses("only 3 photographs have a camera and a GPS position (expected at least 4)"));
}

}  // namespace
}  // namespace b3dgs
