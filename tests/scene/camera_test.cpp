#include "scene/cameras/camera.h"

#include <gtest/gtest.h>

#include <cmath>
#include <random>

#include "core/check.h"

namespace b3dgs {
namespace {

TEST(Camera, QuarterTurnAboutZTakesXToY) {
  const double half = std::sqrt(0.5);
  const std::array<double, 9> r = rotation_from_quaternion({half, 0, 0, half});
  const std::array<double, 9> expected{0, -1, 0, 1, 0, 0, 0, 0, 1};
  for (int i = 0; i < 9; ++i) EXPECT_NEAR(r[i], expected[i], 1e-15) << i;
}

TEST(Camera, QuaternionNeedsNoUnitLength) {
  const auto a = rotation_from_quaternion({0.1, 0.2, -0.3, 0.4}), b = rotation_from_quaternion({10, 20, -30, 40});
  for (int i = 0; i < 9; ++i) EXPECT_NEAR(a[i], b[i], 1e-15);
  EXPECT_THROW(rotation_from_quaternion({0, 0, 0, 0}), LogicError);
}

TEST(Camera, RotationAndQuaternionAreInverseAlsoForHalfTurns) {
  std::mt19937 random(7);
  std::normal_distribution<double> normal;
  std::vector<std::array<double, 4>> quats{{1, 0, 0, 0}, {0, 1, 0, 0}, {0, 0, 1, 0}, {0, 0, 0, 1}, {1e-9, 0.6, 0.8, 0}};
  for (int i = 0; i < 200; ++i) quats.push_back({normal(random), normal(random), normal(random), normal(random)});
  for (const auto& quat : quats) {
    const auto r = rotation_from_quaternion(quat);
    const auto back = quaternion_from_rotation(r);
    EXPECT_GE(back[0], 0);
    EXPECT_NEAR(back[0] * back[0] + back[1] * back[1] + back[2] * back[2] + back[3] * back[3], 1, 1e-14);
    const auto again = rotation_from_quaternion(back);
    for (int i = 0; i < 9; ++i) EXPECT_NEAR(r[i], again[i], 1e-14);
  }
}

TEST(Camera, CenterIsWhereThePoseMapsToZero) {
  Camera camera;
  camera.cam_from_world.rotation = rotation_from_quaternion({0.3, -0.5, 0.7, 0.2});
  camera.cam_from_world.translation = {1, -2, 3};
  const auto c = camera.center();
  const auto& r = camera.cam_from_world.rotation;
  for (int i = 0; i < 3; ++i) {
    EXPECT_NEAR(r[3 * i] * c[0] + r[3 * i + 1] * c[1] + r[3 * i + 2] * c[2] + camera.cam_from_world.translation[i], 0,
                1e-14);
  }
}

TEST(Camera, ScalesIntrinsicsPerAxis) {
  Camera camera;
  camera.width = 100;
  camera.height = 60;
  camera.fx = 80;
  camera.fy = 90;
  camera.cx = 51;
  camera.cy = 29;
  const Camera scaled = camera.scaled_to(50, 20);
  EXPECT_EQ(scaled.width, 50);
  EXPECT_EQ(scaled.height, 20);
  EXPECT_DOUBLE_EQ(scaled.fx, 40);
  EXPECT_DOUBLE_EQ(scaled.fy, 30);
  EXPECT_DOUBLE_EQ(scaled.cx, 25.5);
  EXPECT_DOUBLE_EQ(scaled.cy, 29.0 / 3);
}

/// A camera that looks along the angle `heading` about the vertical axis z, and down by `pitch`.
Camera camera_at(double heading, double pitch) {
  const double ch = std::cos(heading), sh = std::sin(heading), cp = std::cos(pitch), sp = std::sin(pitch);
  Camera camera;
  camera.cam_from_world.rotation = {sh, -ch, 0, -sp * ch, -sp * sh, -cp, cp * ch, cp * sh, -sp};
  return camera;
}

TEST(UpDirection, IsThatOfTheWorldAlsoIfCamerasLookDown) {
  std::vector<Camera> cameras;
  for (int i = 0; i < 6; ++i) cameras.push_back(camera_at(0.3 * i, 0.8));
  const std::array<double, 3> up = up_direction(cameras).value();
  EXPECT_NEAR(up[0], 0, 1e-9);
  EXPECT_NEAR(up[1], 0, 1e-9);
  EXPECT_NEAR(up[2], 1, 1e-9);
}

TEST(UpDirection, IsThatOfTheCamerasIfTheyAllLookTheSameWay) {
  const std::array<double, 3> up = up_direction({camera_at(0, 0.2), camera_at(0.01, 0.2)}).value();
  EXPECT_NEAR(up[2], std::cos(0.2), 1e-3);
}

TEST(UpDirection, IsUnknownIfCamerasDoNotAgree) {
  EXPECT_FALSE(up_direction({}));
  Camera upside_down = camera_at(0, 0);
  for (std::size_t i = 0; i < 6; ++i) upside_down.cam_from_world.rotation[i] *= -1;
  EXPECT_FALSE(up_direction({camera_at(0, 0), upside_down}));
}

}  // namespace
}  // namespace b3dgs
