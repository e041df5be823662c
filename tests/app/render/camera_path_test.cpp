#include "app/render/camera_path.h"

#include <gtest/gtest.h>

#include <cmath>

namespace b3dgs {
namespace {

/// Returns a camera at `center`, rotated by `angle` (rad) about its y axis.
Camera camera_at(const std::array<double, 3>& center, double angle) {
  Camera camera;
  camera.width = 100;
  camera.height = 80;
  camera.fx = camera.fy = 90;
  camera.cx = 50;
  camera.cy = 40;
  const double c = std::cos(angle), s = std::sin(angle);
  camera.cam_from_world.rotation = {c, 0, s, 0, 1, 0, -s, 0, c};
  for (std::size_t i = 0; i < 3; ++i) {
    const std::array<double, 9>& r = camera.cam_from_world.rotation;
    camera.cam_from_world.translation[i] =
        -(r[3 * i] * center[0] + r[3 * i + 1] * center[1] + r[3 * i + 2] * center[2]);
  }
  return camera;
}

double turn_of(const Camera& camera) {
  return std::atan2(camera.cam_from_world.rotation[2], camera.cam_from_world.rotation[0]);
}

TEST(InterpolateCameras, PassesThroughEveryKey) {
  const std::vector<Camera> keys{camera_at({0, 0, 0}, 0), camera_at({1, 2, 0}, 0.7), camera_at({3, 1, -1}, -0.4)};
  const std::vector<Camera> path = interpolate_cameras(keys, 5);
  ASSERT_EQ(path.size(), 5u);
  for (std::size_t key = 0; key < 3; ++key) {
    const Camera& frame = path[2 * key];
    for (std::size_t i = 0; i < 3; ++i) EXPECT_NEAR(frame.center()[i], keys[key].center()[i], 1e-12);
    for (std::size_t i = 0; i < 9; ++i) {
      EXPECT_NEAR(frame.cam_from_world.rotation[i], keys[key].cam_from_world.rotation[i], 1e-12);
    }
  }
}

TEST(InterpolateCameras, RotatesUniformlyAlongTheShortArc) {
  const std::vector<Camera> path = interpolate_cameras({camera_at({0, 0, 0}, 3.0), camera_at({0, 0, 0}, -3.0)}, 3);
  // The short arc from 3 to -3 rad has 0.283 rad, across pi; the long one has 6 rad, across 0.
  EXPECT_NEAR(std::cos(turn_of(path[1])), -1, 1e-12);
}

TEST(InterpolateCameras, MovesUniformlyAlongEquallySpacedKeys) {
  std::vector<Camera> keys;
  for (int i = 0; i < 4; ++i) keys.push_back(camera_at({2.0 * i, 0, 0}, 0));
  const std::vector<Camera> path = interpolate_cameras(keys, 31);
  for (std::size_t i = 10; i <= 20; ++i) EXPECT_NEAR(path[i].center()[0], 0.2 * static_cast<double>(i), 1e-12);
}

TEST(InterpolateCameras, UsesTheImageSizeOfTheFirstKey) {
  const std::vector<Camera> keys{camera_at({0, 0, 0}, 0), camera_at({1, 0, 0}, 0).scaled_to(200, 160)};
  const std::vector<Camera> path = interpolate_cameras(keys, 3);
  for (const Camera& camera : path) {
    EXPECT_EQ(camera.width, 100);
    EXPECT_EQ(camera.height, 80);
    EXPECT_NEAR(camera.fx, 90, 1e-12);
  }
}

TEST(InterpolateCameras, AcceptsOneKeyOrOneFrame) {
  EXPECT_EQ(interpolate_cameras({camera_at({1, 2, 3}, 0)}, 4).size(), 4u);
  EXPECT_NEAR(interpolate_cameras({camera_at({1, 2, 3}, 0)}, 4)[3].center()[2], 3, 1e-12);
  EXPECT_EQ(interpolate_cameras({camera_at({1, 2, 3}, 0), camera_at({4, 5, 6}, 0)}, 1).size(), 1u);
}

}  // namespace
}  // namespace b3dgs
