// The frame of a scene. Neither its unit of length nor its position in the world changes the cameras' pictures.
#include "scene/cameras/coordinate_frame.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <vector>

#include "core/random.h"
#include "scene/points/point_cloud.h"

namespace b3dgs {
namespace {

using Vec = std::array<double, 3>;

/// Eight cameras on a circle of radius 4 that look at its centre, and points around it.
struct Ring {
  std::vector<Camera> cameras;
  std::vector<double> points;
};

Camera camera_at(const Vec& center, double angle) {
  Camera camera;
  camera.width = 64;
  camera.height = 48;
  camera.fx = camera.fy = 60;
  camera.cx = 32;
  camera.cy = 24;
  const double s = std::sin(angle), c = std::cos(angle);
  camera.cam_from_world.rotation = {s, 0, -c, 0, 1, 0, c, 0, s};  // forward (c, 0, s)
  const std::array<double, 9>& r = camera.cam_from_world.rotation;
  for (std::size_t row = 0; row < 3; ++row) {
    camera.cam_from_world.translation[row] =
        -(r[3 * row] * center[0] + r[3 * row + 1] * center[1] + r[3 * row + 2] * center[2]);
  }
  return camera;
}

/// Transforms coordinates: x' = scale * x + shift.
Ring ring(double scale = 1, const Vec& shift = {}) {
  Ring result;
  for (int i = 0; i < 8; ++i) {
    const double angle = 0.785398163397448 * i;
    result.cameras.push_back(
        camera_at({shift[0] - 4 * scale * std::cos(angle), shift[1], shift[2] - 4 * scale * std::sin(angle)}, angle));
  }
  for (std::uint64_t i = 0; i < 500; ++i) {
    const std::array<float, 4> u = random_uniform({3, RandomStream::kScenePoints, 0}, i);
    for (std::size_t axis = 0; axis < 3; ++axis) result.points.push_back(shift[axis] + scale * (2.0 * u[axis] - 1));
  }
  return result;
}

TEST(SceneFrame, TheTypicalDepthHasTheSameLengthInEveryScene) {
  for (const double scale : {1e-4, 0.03, 1.0, 1e4}) {
    for (const Vec& shift : {Vec{}, Vec{1e6, -2e6, 3e5}}) {
      const Ring scene = ring(scale, shift);
      const CoordinateFrame frame = choose_frame(scene.cameras, scene.points);
      EXPECT_NEAR(frame.unit * kTypicalDepth, 4 * scale, 0.1 * scale);
      for (std::size_t axis = 0; axis < 3; ++axis) EXPECT_NEAR(frame.origin[axis], shift[axis], 1e-6 * scale + 1e-9);
      EXPECT_EQ(frame.is_far(), shift[0] > 1000 * scale);
    }
  }
}

double largest(const RelativeDistances& distances) {
  return *std::max_element(distances.values.begin(), distances.values.end());
}

TEST(RelativeDistances, CompareWithTheOthersAndWithWhatTheySee) {
  for (const double scale : {0.01, 1.0, 1e4}) {
    for (const Vec& shift : {Vec{}, Vec{5e5, -5e6, 300}}) {  // as in UTM coordinates
      Ring scene = ring(scale, shift);
      EXPECT_LT(largest(relative_distances(scene.cameras, scene.points)), 3);
      scene.cameras[3] = camera_at({shift[0] + 3e6 * scale, shift[1], shift[2]}, 0);
      for (const std::vector<double>& points : {scene.points, std::vector<double>{}}) {
        EXPECT_NEAR(relative_distances(scene.cameras, points).values[3], 3e6 / 4, 2e5);
        EXPECT_LT(largest(relative_distances(usual_cameras(scene.cameras, points), points)), 3) << "all but that one";
      }
    }
  }
}

TEST(RelativeDistances, AreSmallForPhotographsOfOnePlace) {
  const Vec place{7, -2, 1};
  std::vector<Camera> cameras{camera_at(place, 0)};
  const std::vector<double> points{9, -2, 1};
  EXPECT_EQ(largest(relative_distances(cameras, points)), 0);
  for (int i = 1; i < 8; ++i) cameras.push_back(camera_at(place, 0.7 * i));
  EXPECT_LT(largest(relative_distances(cameras, points)), 1e-9);
  cameras.push_back(camera_at({9, 0, 1}, 3));
  EXPECT_NEAR(largest(relative_distances(cameras, points)), std::sqrt(2.0), 1e-9) << "relative to the depth, 2";
  EXPECT_EQ(largest(relative_distances(cameras, {})), 0) << "centres that differ by rounding are no measure";
}

TEST(RelativeDistances, AreSmallIfMostStandInOnePlace) {  // a tripod, or a vehicle that waits
  for (const double noise : {0.0, 1e-12, 1e-4}) {
    std::vector<Camera> cameras;
    for (int i = 0; i < 8; ++i) cameras.push_back(camera_at({noise * (i % 3), noise * (i % 2), 0}, 0));
    for (int i = 1; i < 5; ++i) cameras.push_back(camera_at({10.0 * i, 0, 0}, 0));
    EXPECT_LT(largest(relative_distances(cameras, {})), 2) << noise;
  }
  EXPECT_EQ(largest(relative_distances({camera_at({0, 0, 0}, 0), camera_at({1e7, 0, 0}, 0)}, {})), 0)
      << "which of the two?";
}

/// Returns 25 close-ups at distance 1 from the points in the middle, and `n_far` cameras that look there from `radius`.
Ring close_ups_and(int n_far, double radius) {
  Ring result = ring(0.25);
  result.cameras.clear();
  for (int i = 0; i < 25 + n_far; ++i) {
    const double angle = 2.399963 * i, distance = i < 25 ? 1 : radius;
    result.cameras.push_back(camera_at({-distance * std::cos(angle), 0, -distance * std::sin(angle)}, angle));
  }
  return result;
}

TEST(LimitedRadius, IsTheSameWhateverTheShareOfFarCameras) {
  for (const int n_far : {1, 5, 8, 9, 12, 20}) {
    const Ring scene = close_ups_and(n_far, 40);
    EXPECT_NEAR(limited_radius(scene.cameras, scene.points), kMostRadius, 0.1 * kMostRadius) << n_far;
  }
  const Ring near = close_ups_and(8, 3);
  EXPECT_EQ(limited_radius(near.cameras, near.points), camera_radius(near.cameras));
}

TEST(LimitedRadius, BoundsWrongRegistrationsOfAThirdOfTheCameras) {
  const Ring scene = close_ups_and(12, 1000);
  EXPECT_NEAR(limited_radius(scene.cameras, scene.points), kMostRadius, 0.1 * kMostRadius);
  const std::vector<double> distances = relative_distances(scene.cameras, scene.points).values;
  EXPECT_EQ(std::count_if(distances.begin(), distances.end(), [](double times) { return times > kFarTimes; }), 12);
}

TEST(LimitedRadius, IsNotLimitedForFewCameras) {
  for (const int n : {3, 4}) {
    std::vector<Camera> cameras;
    for (int i = 0; i < n; ++i) cameras.push_back(camera_at({i + 1 < n ? 1.0 * i : 1000.0, 0, 0}, 0));
    EXPECT_EQ(largest(relative_distances(cameras, {})), 0) << n;
    EXPECT_EQ(limited_radius(cameras, {}), camera_radius(cameras)) << n;
  }
}

TEST(UsualCameras, SetTheFrameAlthoughAFewAreRegisteredFarAway) {
  const Ring scene = ring(1, {});
  const CoordinateFrame expected = choose_frame(scene.cameras, scene.points);
  Ring wrong = scene;
  wrong.cameras.push_back(camera_at({1200, 0, 0}, 0));
  wrong.cameras.push_back(camera_at({0, 400, -300}, 1));
  EXPECT_EQ(usual_cameras(wrong.cameras, wrong.points).size(), scene.cameras.size());
  const CoordinateFrame found = choose_frame(wrong.cameras, wrong.points);
  EXPECT_NEAR(found.unit, expected.unit, 0.05 * expected.unit);
  for (std::size_t axis = 0; axis < 3; ++axis) EXPECT_NEAR(found.origin[axis], expected.origin[axis], 1e-9);
}

TEST(SceneFrame, CoordinatesInItDoNotDependOnUnitAndPlace) {
  const Ring scene = ring();
  const CoordinateFrame frame = choose_frame(scene.cameras, scene.points);
  const PointCloud points = in_frame(frame, {scene.points, {}});
  for (const double scale : {1e-4, 1e4}) {
    for (const Vec& shift : {Vec{}, Vec{1e6, -2e6, 3e5}}) {
      const Ring other = ring(scale, shift);
      const CoordinateFrame own = choose_frame(other.cameras, other.points);
      const PointCloud others = in_frame(own, {other.points, {}});
      // 1e6 in double precision has steps of 1e-10.
      const double tolerance = 1e-6 + 1e-9 * std::abs(shift[0]) / scale / 1e6;
      ASSERT_EQ(others.positions.size(), points.positions.size());
      for (std::size_t i = 0; i < points.positions.size(); ++i) {
        ASSERT_NEAR(others.positions[i], points.positions[i], tolerance + 1e-5 * (scale < 1 && shift[0] != 0));
      }
      for (std::size_t i = 0; i < scene.cameras.size(); ++i) {
        const Camera a = change_frame({}, frame, scene.cameras[i]), b = change_frame({}, own, other.cameras[i]);
        for (std::size_t axis = 0; axis < 3; ++axis) {
          EXPECT_NEAR(a.center()[axis], b.center()[axis], tolerance + 1e-5 * (scale < 1 && shift[0] != 0));
        }
      }
    }
  }
}

TEST(SceneFrame, ACameraSeesThePointsWhereItSawThem) {
  const Ring scene = ring(0.5, {10, 20, 30});
  const CoordinateFrame frame = choose_frame(scene.cameras, scene.points), elsewhere{{1, 2, 3}, 7};
  for (const Camera& camera : scene.cameras) {
    const Camera moved = change_frame({}, frame, camera), further = change_frame(frame, elsewhere, moved);
    const Camera back = change_frame(elsewhere, {}, further);
    for (std::size_t i = 0; i < scene.points.size(); i += 30) {
      const double* const world = &scene.points[i];
      const auto before = camera.project(world);
      const auto after = moved.project(frame.from_world(world).data());
      const auto later = further.project(elsewhere.from_world(world).data());
      ASSERT_EQ(before.has_value(), after.has_value());
      ASSERT_EQ(before.has_value(), later.has_value());
      if (!before) continue;
      EXPECT_NEAR(after->x, before->x, 1e-9);
      EXPECT_NEAR(later->y, before->y, 1e-9);
      EXPECT_NEAR(after->depth * frame.unit, before->depth, 1e-9);
    }
    for (std::size_t i = 0; i < 3; ++i) {
      EXPECT_NEAR(back.cam_from_world.translation[i], camera.cam_from_world.translation[i], 1e-12);
    }
  }
}

TEST(SceneFrame, WithoutPointsWhatTheCamerasLookAtCounts) {
  const Ring scene = ring(2, {100, 0, 0});
  EXPECT_NEAR(choose_frame(scene.cameras, {}).unit * kTypicalDepth, 8, 1e-6);
  // Cameras side by side that look ahead: the length of their path.
  const std::vector<Camera> row{camera_at({0, 0, 0}, 0), camera_at({0, 0, 3}, 0), camera_at({0, 0, 6}, 0)};
  EXPECT_NEAR(choose_frame(row, {}).unit * kTypicalDepth, 3, 1e-9);
  // Cameras that look outwards, away from the point where the axes meet.
  std::vector<Camera> outwards;
  for (int i = 0; i < 4; ++i) {
    const double angle = 1.5707963267948966 * i;
    outwards.push_back(camera_at({std::cos(angle), 0, std::sin(angle)}, angle));
  }
  EXPECT_NEAR(choose_frame(outwards, {}).unit * kTypicalDepth, 1, 1e-9);
  EXPECT_EQ(choose_frame({scene.cameras[0]}, {}).unit, 1) << "one camera says nothing";
  EXPECT_EQ(choose_frame({}, {}), CoordinateFrame{});
}

TEST(SceneFrame, WithoutCamerasThePointsCount) {
  const Ring scene = ring(3, {5e5, 0, 0});
  const CoordinateFrame frame = choose_frame({}, scene.points);
  EXPECT_NEAR(frame.origin[0], 5e5, 0.5);
  EXPECT_TRUE(frame.is_far());
  EXPECT_NEAR(frame.unit / choose_frame({}, ring(1).points).unit, 3, 1e-6);
}

}  // namespace
}  // namespace b3dgs
