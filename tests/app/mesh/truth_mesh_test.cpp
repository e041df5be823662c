#include "data_synth/truth_mesh.h"

#include <gtest/gtest.h>

#include <cmath>

#include "data_synth/synth_writer.h"
#include "support/temp_dir.h"

namespace b3dgs {
namespace {

double area_of(const TriangleMesh& mesh) {
  double area = 0;
  for (const TriangleMesh::Triangle& triangle : mesh.triangles) {
    const Vec3<double> normal = mesh.area_normal(triangle);
    area += 0.5 * std::sqrt(dot(normal, normal));
  }
  return area;
}

TEST(TruthMesh, HasTheAreaOfTheSolids) {
  const double expected = kPi * kGroundRadius * kGroundRadius + 4 * kPi * kBallRadius * kBallRadius +
                          5 * (2 * kBoxHalf) * (2 * kBoxHalf) + 4 * kPi * kPi * kRingMajor * kRingMinor;
  EXPECT_NEAR(area_of(orbit_truth_mesh()), expected, 2e-4 * expected);
}

TEST(TruthMesh, FacesPointOutward) {
  TriangleMesh ball, ring, box;
  append_ball({0, 0, 0}, 1, ball);
  append_ring({0, 0, 0}, 1, 0.3, ring);
  append_box({0, 0, 0}, {1, 2, 3}, true, box);
  EXPECT_EQ(box.triangles.size(), 12u);
  const auto outward = [](const TriangleMesh& mesh, const TriangleMesh::Triangle& t, double ring_radius) {
    const Vec3<double> a = mesh.position(t[0]);
    const double around = std::hypot(a.x, a.y), inward = ring_radius / around;
    const Vec3<double> from_core{a.x - inward * a.x, a.y - inward * a.y, a.z};
    return dot(from_core, mesh.area_normal(t));
  };
  for (const auto& triangle : ring.triangles) EXPECT_GT(outward(ring, triangle, 1), 0);
  for (const TriangleMesh* mesh : {&ball, &box}) {
    for (const auto& t : mesh->triangles) EXPECT_GT(dot(mesh->position(t[1]), mesh->area_normal(t)), 0);
  }
}

TEST(TruthMesh, IsWrittenWithOrbitOnly) {
  const test::TempDir folder;
  SynthConfig config;
  config.output = (folder / "scene").string();
  config.points = 100;
  config.views = 2;
  config.width = 32;
  config.height = 24;
  write_synth_scene(config, make_scene(config));
  const TriangleMesh mesh = read_mesh_ply(folder / "scene" / "truth_mesh.ply");
  EXPECT_EQ(mesh.triangles, orbit_truth_mesh().triangles);
  config.scene = "street";
  write_synth_scene(config, make_scene(config));
  EXPECT_FALSE(std::filesystem::exists(folder / "scene" / "truth_mesh.ply")) << "street has no surface";
}

}  // namespace
}  // namespace b3dgs
