#include "app/mesh/mesh_distance.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>

#include "app/mesh/triangle_scene.h"
#include "data_synth/random.h"
#include "data_synth/truth_mesh.h"

namespace b3dgs {
namespace {

constexpr std::int64_t kSamples = 20000;

TriangleMesh ball(double radius) {
  TriangleMesh mesh;
  append_ball({0.2, 0, 0}, radius, mesh);
  return mesh;
}

TEST(MeshDistance, NearestIsThatOfAllTriangles) {
  TriangleMesh mesh;
  append_ring({0, 0, 0}, 0.5, 0.2, mesh);
  append_box({0.4, 0, 0.2}, {0.1, 0.2, 0.3}, true, mesh);
  const TriangleScene scene(mesh);
  Random random(3);
  for (int i = 0; i < 50; ++i) {
    const Vec3<double> point{random.uniform(-1, 1), random.uniform(-1, 1), random.uniform(-1, 1)};
    double expected = 1e9;
    for (const TriangleMesh::Triangle& t : mesh.triangles) {
      const double distance =
          distance_from_triangle(point, mesh.position(t[0]), mesh.position(t[1]), mesh.position(t[2]));
      expected = std::min(expected, distance);
    }
    EXPECT_NEAR(scene.nearest(point).distance, expected, 1e-6);
  }
}

TEST(MeshDistance, FromATriangle) {
  const Vec3<double> a{0, 0, 0}, b{2, 0, 0}, c{0, 2, 0};
  const auto from = [&](double x, double y, double z) { return distance_from_triangle({x, y, z}, a, b, c); };
  EXPECT_DOUBLE_EQ(from(0.5, 0.5, 3), 3) << "above the face";
  EXPECT_DOUBLE_EQ(from(1, -4, 3), 5) << "beside an edge";
  EXPECT_DOUBLE_EQ(from(-3, -4, 0), 5) << "beyond a corner";
  EXPECT_DOUBLE_EQ(distance_from_triangle({1, 2, 0}, a, b, b), 2) << "without area";
}

TEST(MeshDistance, OfBallsIsTheDifferenceOfTheirRadii) {
  const MeshQuality quality = compare_meshes(ball(0.52), ball(0.5), {}, 0.03, kSamples);
  for (const SurfaceDistance& distance : {quality.accuracy, quality.completeness}) {
    EXPECT_EQ(distance.n_points, kSamples);
    EXPECT_NEAR(distance.mean, 0.02, 2e-4);
    EXPECT_NEAR(distance.p95, 0.02, 3e-4);
    EXPECT_EQ(distance.share, 1);
    EXPECT_EQ(distance.share_of_half, 0);
    EXPECT_LT(distance.degrees, 1.5);
  }
  EXPECT_NEAR(quality.chamfer(), 0.02, 2e-4);
  EXPECT_EQ(quality.f_score(), 1);
  EXPECT_EQ(quality.f_score_of_half(), 0);
}

TEST(MeshDistance, IsZeroForTheSameMesh) {
  const MeshQuality quality = compare_meshes(ball(0.5), ball(0.5), {}, 0.01, kSamples);
  EXPECT_NEAR(quality.chamfer(), 0, 1e-7);
  EXPECT_LT(quality.accuracy.degrees, 0.1);
}

// Points count by area, so it does not matter how finely a part is divided.
TEST(MeshDistance, LacksWhatIsMissing) {
  TriangleMesh truth, half;
  append_box({0, 0, 0}, {1, 1, 1}, true, truth);
  append_box({0, 0, 0}, {1, 1, 1}, false, half);
  const MeshQuality quality = compare_meshes(half, truth, {}, 0.1, kSamples);
  EXPECT_EQ(quality.accuracy.share, 1);
  // A margin of 0.1 of the missing side is within the threshold of the others.
  EXPECT_NEAR(quality.completeness.share, (5 + (4 - 1.8 * 1.8) / 4) / 6, 0.005);
}

TEST(MeshDistance, PartsBeyondTheTruthDoNotCount) {
  TriangleMesh mesh = ball(0.5);
  append_box({9, 0, 0}, {1, 1, 1}, true, mesh);
  const MeshQuality quality = compare_meshes(mesh, ball(0.5), {}, 0.01, kSamples);
  EXPECT_LT(quality.accuracy.n_points, kSamples / 5);
  EXPECT_EQ(quality.accuracy.share, 1);
}

TEST(MeshDistance, OnlySeenTruthCounts) {
  TriangleMesh truth;
  append_box({0, 0, 0}, {1, 1, 1}, true, truth);
  const Camera above = Camera::with_field_of_view(100, 100, 60, {{1, 0, 0, 0, -1, 0, 0, 0, -1}, {0, 0, 5}});
  const auto seen_by = [&](const std::vector<Camera>& cameras) {
    return compare_meshes(truth, truth, cameras, 0.1, kSamples).completeness.n_points;
  };
  EXPECT_EQ(seen_by({above}), 0) << "one camera is not enough";
  EXPECT_NEAR(static_cast<double>(seen_by({above, above})), kSamples / 6.0, kSamples / 100.0);
}

}  // namespace
}  // namespace b3dgs
