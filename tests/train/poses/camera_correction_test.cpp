// Tests corrections of a camera's pose: their effect, their gradient, and their limits.
#include "train/poses/pose_refiner.h"

#include <gtest/gtest.h>

#include <vector>

#include "core/vec.h"
#include "support/finite_difference.h"

namespace b3dgs {
namespace {

Pose some_pose() {
  return {rotation_from_quaternion({0.8, -0.3, 0.4, 0.2}), {0.4, -1.3, 2.2}};
}

Camera camera_with(const Pose& pose) {
  Camera camera;
  camera.cam_from_world = pose;
  return camera;
}

double length(Vec3d v) {
  return std::sqrt(dot(v, v));
}

TEST(CameraCorrection, OfZeroChangesNothing) {
  const Pose pose = some_pose(), same = corrected(pose, {});
  EXPECT_EQ(same.rotation, pose.rotation);
  EXPECT_EQ(same.translation, pose.translation);
}

TEST(CameraCorrection, TurnsByItsAngleAndMovesTheCentreByItsLength) {
  const Pose pose = some_pose();
  for (const double scale : {1e-6, 1e-3, 0.05, 1.0}) {
    const CameraCorrection correction{{0.3 * scale, -0.5 * scale, 0.2 * scale}, {0.01, 0.02, -0.05}};
    const Pose moved = corrected(pose, correction);
    double trace = 0;
    for (std::size_t i = 0; i < 9; ++i) trace += moved.rotation[i] * pose.rotation[i];
    EXPECT_NEAR(trace, 1 + 2 * std::cos(length(correction.rotation)), 1e-14);
    const auto before = camera_with(pose).center(), after = camera_with(moved).center();
    const Vec3d way{after[0] - before[0], after[1] - before[1], after[2] - before[2]};
    EXPECT_NEAR(length(way), length(correction.translation), 1e-14);
    // Rotation matrices stay orthonormal.
    const auto q = quaternion_from_rotation(moved.rotation);
    const auto again = rotation_from_quaternion(q);
    for (std::size_t i = 0; i < 9; ++i) EXPECT_NEAR(again[i], moved.rotation[i], 1e-14);
  }
}

TEST(CameraCorrection, TurnsFromTheFirstToTheSecondAxisAboutTheThird) {
  const Vec3d turned = rotate({0, 0, kPi / 2}, {1, 0, 0});
  EXPECT_NEAR(turned.x, 0, 1e-15);
  EXPECT_NEAR(turned.y, 1, 1e-15);
  EXPECT_NEAR(turned.z, 0, 1e-15);
}

TEST(CameraCorrection, SeriesForSmallAnglesAgreesWithTheFormulas) {
  for (const double angle : {0.9e-3, 0.99e-3}) {
    const detail::AngleRatios series = detail::angle_ratios(angle * angle);
    EXPECT_NEAR(series.sine, std::sin(angle) / angle, 1e-15);
    EXPECT_NEAR(series.cosine, 2 * std::pow(std::sin(angle / 2) / angle, 2), 1e-15);
    EXPECT_NEAR(series.rest, (angle - std::sin(angle)) / (angle * angle * angle), 1e-6);  // cancellation in the formula
  }
}

/// Returns a smooth function of a camera, from the positions at which it sees three points.
double seen(const Pose& pose) {
  double sum = 0, weight = 1;
  for (const Vec3d p : {Vec3d{0.2, 0.5, 1.0}, Vec3d{-0.7, 0.1, 0.4}, Vec3d{0.3, -0.2, 0.9}}) {
    const auto& r = pose.rotation;
    const auto& t = pose.translation;
    const Vec3d c{r[0] * p.x + r[1] * p.y + r[2] * p.z + t[0], r[3] * p.x + r[4] * p.y + r[5] * p.z + t[1],
                  r[6] * p.x + r[7] * p.y + r[8] * p.z + t[2]};
    sum += weight * c.x * c.x - c.y * c.z + 0.3 * weight * c.z * c.z * c.z;
    weight -= 0.7;
  }
  return sum;
}

TEST(CameraCorrection, GradientAgreesWithFiniteDifferences) {
  const Pose pose = some_pose();
  const auto of = [](const std::vector<double>& x) { return CameraCorrection{{x[0], x[1], x[2]}, {x[3], x[4], x[5]}}; };
  for (const std::vector<double>& at : {std::vector<double>(6), std::vector<double>{0.03, -0.02, 0.01, 0.3, -0.2, 0.4},
                                        std::vector<double>{0.4, 0.9, -0.5, -0.3, 0.6, 0.1}}) {
    const auto value = [&](const std::vector<double>& x) { return seen(corrected(pose, of(x))); };
    // Gradient with respect to a small motion of the corrected camera.
    const Pose there = corrected(pose, of(at));
    const std::vector<double> motion = test::numeric_gradient(
        [&](const std::vector<double>& x) { return seen(corrected(there, of(x))); }, std::vector<double>(6));
    const CameraCorrection found = correction_grad(of(at), of(motion));
    EXPECT_TRUE(test::gradients_agree({found.rotation.x, found.rotation.y, found.rotation.z, found.translation.x,
                                       found.translation.y, found.translation.z},
                                      test::numeric_gradient(value, at), 1e-8));
  }
}

TEST(CameraCorrection, IsLimitedInItsDirection) {
  constexpr double kMostAngle = 0.05, kMostDistance = 0.3;
  const CameraCorrection large = limited({{3, -4, 0}, {0, 0.6, 0.8}}, kMostAngle, kMostDistance);
  EXPECT_NEAR(large.rotation.x, 0.03, 1e-15);
  EXPECT_NEAR(large.rotation.y, -0.04, 1e-15);
  EXPECT_NEAR(large.translation.y, 0.18, 1e-15);
  EXPECT_NEAR(large.translation.z, 0.24, 1e-15);
  const CameraCorrection small = limited({{0.03, -0.02, 0}, {0, 0.1, 0.2}}, kMostAngle, kMostDistance);
  EXPECT_EQ(small.rotation.x, 0.03);
  EXPECT_EQ(small.translation.z, 0.2);
}

}  // namespace
}  // namespace b3dgs
