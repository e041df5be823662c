// Circles around the focus of the cameras or the centre of the Gaussians.
#include "app/render/camera_path.h"

#include <gtest/gtest.h>

#include <cmath>

#include "app/render/camera_choice.h"
#include "core/vec.h"

namespace b3dgs {
namespace {

const cv::Vec3d kFocus{3, -2, 5};
const cv::Vec3d kUp{0.6, 0, 0.8};
const cv::Vec3d kAcross{0.8, 0, -0.6};  // perpendicular to kUp, like y

double length(const cv::Vec3d& v) {
  return cv::norm(v);
}
cv::Vec3d center_of(const Camera& camera) {
  return cv::Vec3d(camera.center().data());
}
cv::Vec3d to_camera(const Camera& camera, const cv::Vec3d& p) {
  const auto& [r, t] = camera.cam_from_world;
  return cv::Matx33d(r.data()) * p + cv::Vec3d(t.data());
}

Camera some_lens() {
  Camera lens;
  lens.width = 120;
  lens.height = 80;
  lens.fx = 100;
  lens.fy = 90;
  lens.cx = 55;  // not the centre
  lens.cy = 42;
  return lens;
}

/// Returns cameras at these angles of an ellipse about kUp, looking at kFocus.
std::vector<Camera> cameras_at(const std::vector<double>& angles, double first_radius, double second_radius,
                               double height) {
  std::vector<Camera> cameras;
  for (const double angle : angles) {
    Orbit orbit{kFocus, kUp, kAcross, first_radius, second_radius, height, angle, 0, 0};
    cameras.push_back(cameras_on(orbit, some_lens(), 1).at(0));
  }
  return cameras;
}

void expect_all_look_at(const std::vector<Camera>& cameras, const cv::Vec3d& point, const cv::Vec3d& up) {
  for (const Camera& camera : cameras) {
    const cv::Vec3d focus = to_camera(camera, point), above = to_camera(camera, point + 0.1 * up);
    EXPECT_GT(focus[2], 0);
    EXPECT_NEAR(camera.fx * focus[0] / focus[2] + camera.cx, 0.5 * camera.width, 1e-9);
    EXPECT_NEAR(camera.fy * focus[1] / focus[2] + camera.cy, 0.5 * camera.height, 1e-9);
    EXPECT_NEAR(above[0], 0, 1e-9) << "the horizon is level";
    EXPECT_LT(above[1], 0) << "up is up";
    const std::array<double, 9>& r = camera.cam_from_world.rotation;
    const cv::Vec3d rows[3] = {cv::Vec3d(&r[0]), cv::Vec3d(&r[3]), cv::Vec3d(&r[6])};
    for (int i = 0; i < 3; ++i) EXPECT_NEAR(length(rows[i]), 1, 1e-12);
    EXPECT_NEAR(rows[0].cross(rows[1]).dot(rows[2]), 1, 1e-12);
  }
}

TEST(Turntable, IsAClosedCircleAroundTheFocus) {
  const Orbit orbit = turntable(kFocus, kUp, 4, 0.3, kFocus + cv::Vec3d{0, 7, 0});
  const std::vector<Camera> cameras = cameras_on(orbit, some_lens(), 12);
  ASSERT_EQ(cameras.size(), 12u);
  expect_all_look_at(cameras, kFocus, kUp);
  EXPECT_NEAR((center_of(cameras[0]) - kFocus).dot(cv::Vec3d{0, 1, 0}), 4 * std::cos(0.3), 1e-9) << "starts there";
  for (std::size_t i = 0; i < cameras.size(); ++i) {
    const cv::Vec3d offset = center_of(cameras[i]) - kFocus;
    EXPECT_NEAR(length(offset), 4, 1e-9);
    EXPECT_NEAR(offset.dot(kUp), 4 * std::sin(0.3), 1e-9);
    const Camera& next = cameras[(i + 1) % cameras.size()];  // the loop closes with a step as long as the others
    EXPECT_NEAR(length(center_of(next) - center_of(cameras[i])), 2 * 4 * std::cos(0.3) * std::sin(kPi / 12), 1e-9);
    EXPECT_EQ(cameras[i].width, 120);
    EXPECT_EQ(cameras[i].fx, 100);
  }
}

TEST(OrbitThrough, FollowsTheEllipseOfTheCameras) {
  const std::vector<double> uneven{1.1, 0, 0.2, 0.4, 0.5, 0.6, 2, 3, 3.1, 4, 4.8, 5.5};
  const std::vector<Camera> keys = cameras_at(uneven, 3, 2, 1);
  const Orbit orbit = orbit_through(keys, kFocus, kUp);
  const std::vector<Camera> cameras = cameras_on(orbit, some_lens(), 50);
  expect_all_look_at(cameras, kFocus, kUp);
  for (const Camera& camera : cameras) {
    const cv::Vec3d offset = center_of(camera) - kFocus;
    EXPECT_NEAR(std::hypot(offset.dot(kAcross) / 3, offset.dot(cv::Vec3d{0, 1, 0}) / 2), 1, 1e-9);
    EXPECT_NEAR(offset.dot(kUp), 1, 1e-9);
  }
  EXPECT_NEAR(length(center_of(cameras[0]) - center_of(keys[0])), 0, 1e-9) << "begins at the first camera";
  EXPECT_EQ(orbit.swing, 0);
}

TEST(OrbitThrough, GoesBackAndForthWhereCamerasCoverAnArc) {
  std::vector<Camera> keys = cameras_at({3.1, 2.7, 2.9, 3.3, 3.5}, 3, 3, -1.2);
  for (const Camera& camera : cameras_at({3.1, 2.7, 2.9, 3.3, 3.5}, 3, 3, -0.8)) keys.push_back(camera);
  const Orbit orbit = orbit_through(keys, kFocus, kUp);
  const Coverage coverage = coverage_of(keys, kFocus, kUp, kAcross);
  EXPECT_NEAR(coverage.gap, 2 * kPi - 0.8, 1e-9);
  EXPECT_NEAR(std::cos(coverage.middle), std::cos(3.1), 1e-9);
  const std::vector<Camera> cameras = cameras_on(orbit, some_lens(), 40);
  expect_all_look_at(cameras, kFocus, kUp);
  double least = 9, most = 0;
  for (std::size_t i = 0; i < cameras.size(); ++i) {
    const cv::Vec3d offset = center_of(cameras[i]) - kFocus;
    const double x = offset.dot(kAcross), y = offset.dot(kUp.cross(kAcross)), z = offset.dot(kUp);
    EXPECT_NEAR(std::hypot(x, y), 3, 1e-9);
    EXPECT_NEAR(z, -1, 0.2 + 1e-9);
    const double angle = std::fmod(std::atan2(y, x) + 2 * kPi, 2 * kPi);
    least = std::min(least, angle);
    most = std::max(most, angle);
    const Camera& next = cameras[(i + 1) % cameras.size()];
    EXPECT_LT(length(center_of(next) - center_of(cameras[i])), 0.3) << "closed, without jumps";
    EXPECT_GT(length(center_of(next) - center_of(cameras[i])), 0.005) << "no frame is repeated";
  }
  EXPECT_NEAR(least, 3.1 - 0.36, 1e-3);
  EXPECT_NEAR(most, 3.1 + 0.36, 1e-3);
}

TEST(OrbitThrough, MovesEvenIfAllCamerasStandInOneDirection) {
  const std::vector<Camera> cameras =
      cameras_on(orbit_through(cameras_at({1, 1, 1}, 3, 3, 0), kFocus, kUp), some_lens(), 8);
  expect_all_look_at(cameras, kFocus, kUp);
  EXPECT_GT(length(center_of(cameras[2]) - center_of(cameras[6])), 0.9);
}

TEST(OrbitThrough, StaysFiniteForOneCameraAboveTheFocus) {
  std::vector<Camera> keys = cameras_at({0}, 1e-9, 1e-9, 2);
  for (const Camera& camera : cameras_on(orbit_through(keys, kFocus, kUp), some_lens(), 5)) {
    for (const double value : camera.cam_from_world.rotation) EXPECT_TRUE(std::isfinite(value));
  }
}

TEST(Focus, IsWhereTheAxesMeet) {
  const std::vector<Camera> cameras = cameras_at({0, 1, 2, 4}, 3, 2, 1);
  const cv::Vec3d focus = focus_of(cameras, {100, 100, 100});
  EXPECT_NEAR(length(focus - kFocus), 0, 1e-9);
}

TEST(Focus, OfParallelAxesIsNearTheGaussians) {
  std::vector<Camera> cameras = cameras_at({0}, 3, 3, 0);
  cameras.push_back(cameras[0]);
  const cv::Vec3d side = {0, 1, 0};  // the second camera stands beside the first one, 0.2 farther away
  const Camera& first = cameras[0];
  for (std::size_t i = 0; i < 3; ++i) {
    cameras[1].cam_from_world.translation[i] -= 0.2 * first.cam_from_world.rotation[3 * i + 1] * side[1];
  }
  const cv::Vec3d focus = focus_of(cameras, kFocus + cv::Vec3d{0, 0.1, 0} + 4.0 * kUp);
  EXPECT_NEAR(length(focus - kFocus - cv::Vec3d{0, 0.1, 0}), 0, 0.05);
}

TEST(Focus, IsThatOfTheGaussiansIfCamerasLookOutward) {
  std::vector<Camera> cameras = cameras_at({0, 1, 2, 3, 4, 5}, 3, 3, 0);
  for (Camera& camera : cameras) {  // turned by 180 degrees about their own y axis, with the same centre
    for (const std::size_t row : {0, 2}) {
      for (std::size_t i = 0; i < 3; ++i) camera.cam_from_world.rotation[3 * row + i] *= -1;
      camera.cam_from_world.translation[row] *= -1;
    }
  }
  const cv::Vec3d fallback{1, 2, 3};
  EXPECT_NEAR(length(focus_of(cameras, fallback) - fallback), 0, 1e-12);
}

TEST(SplatBounds, IgnoreFarAndTransparentGaussians) {
  SplatCloud cloud;
  const auto add = [&](float x, float y, float z, float logit_opacity) {
    cloud.means.insert(cloud.means.end(), {x, y, z});
    cloud.logit_opacities.push_back(logit_opacity);
  };
  for (int i = 0; i < 100; ++i) {
    const double angle = 2 * kPi * i / 100;
    add(static_cast<float>(7 + 2 * std::cos(angle)), static_cast<float>(2 * std::sin(angle)), 1, 3);
  }
  for (int i = 0; i < 20; ++i) add(1e6f, 1e6f, 1e6f, 3);
  for (int i = 0; i < 300; ++i) add(-50, -50, -50, -8);
  const SplatBounds bounds = splat_bounds(cloud);
  EXPECT_NEAR(bounds.center[0], 7, 1);
  EXPECT_NEAR(bounds.center[1], 0, 1);
  EXPECT_NEAR(bounds.center[2], 1, 1e-6);
  EXPECT_NEAR(bounds.radius, 2, 0.7);
  EXPECT_GT(splat_bounds(SplatCloud()).radius, 0);
}

TEST(FitToSize, KeepsTheVerticalAngleOfView) {
  const Camera lens = some_lens();
  const Camera fitted = fit_to_size(lens, {300, 160});
  EXPECT_EQ(fitted.width, 300);
  EXPECT_NEAR(fitted.fy, 180, 1e-12);
  EXPECT_NEAR(fitted.fx, 200, 1e-12);
  EXPECT_NEAR(fitted.cx, 150 + 2 * (55 - 60), 1e-12);
  EXPECT_NEAR(fitted.cy, 80 + 2 * (42 - 40), 1e-12);
  EXPECT_EQ(fit_to_size(lens, {120, 80}).cx, 55);
  // The field of view along the height of an upright camera becomes that along the width.
  const Camera turned = fit_longer_side({60, 80, 100, 100, 30, 42, {}, {}}, {1920, 1080});
  EXPECT_EQ(turned.width, 1920);
  EXPECT_EQ(turned.height, 1080);
  EXPECT_EQ(turned.fx, 100 * 1920 / 80.0);
  EXPECT_EQ(turned.fy, 100 * 1920 / 80.0);
  EXPECT_EQ(turned.cx, 960);
  EXPECT_EQ(turned.cy, 540 + 2 * 1920 / 80.0);
}

}  // namespace
}  // namespace b3dgs
