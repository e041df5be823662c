#include "app/mesh/mesh_cleaning.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <set>

#include "data_synth/truth_mesh.h"

namespace b3dgs {
namespace {

/// Makes the surface of unit cubes whose lower corners are given. Equal positions are one vertex.
TriangleMesh cubes(const std::vector<Vec3f>& corners) {
  TriangleMesh mesh;
  for (const Vec3f& corner : corners) {
    TriangleMesh cube;
    append_box({corner.x + 0.5, corner.y + 0.5, corner.z + 0.5}, {0.5, 0.5, 0.5}, true, cube);
    for (TriangleMesh::Triangle triangle : cube.triangles) {
      for (std::uint32_t& vertex : triangle) {
        const Vec3f p = cube.positions[vertex];
        std::uint32_t found = 0;
        for (; found < mesh.positions.size(); ++found) {
          const Vec3f& q = mesh.positions[found];
          if (p.x == q.x && p.y == q.y && p.z == q.z) break;
        }
        if (found == mesh.positions.size()) mesh.positions.push_back(p);
        vertex = found;
      }
      mesh.triangles.push_back(triangle);
    }
  }
  return mesh;
}

TEST(MeshCleaning, EdgesOfACubeAreManifold) {
  const TriangleMesh mesh = cubes({{0, 0, 0}});
  EXPECT_EQ(mesh.positions.size(), 8u);
  EXPECT_EQ(count_edges(mesh).boundary_edges, 0u);
  EXPECT_EQ(count_edges(mesh).non_manifold_edges, 0u);
}

TEST(MeshCleaning, CubesThatShareAnEdgeAreSplit) {
  TriangleMesh mesh = cubes({{0, 0, 0}, {1, 1, 0}});
  EXPECT_EQ(mesh.positions.size(), 14u);
  EXPECT_EQ(count_edges(mesh).non_manifold_edges, 1u);
  EXPECT_EQ(split_non_manifold(mesh), 2u);
  EXPECT_EQ(count_edges(mesh).non_manifold_edges, 0u);
  EXPECT_EQ(count_edges(mesh).boundary_edges, 0u);
  EXPECT_EQ(remove_small_components(mesh, 0.5).kept, 2u) << "each cube must be whole";
}

TEST(MeshCleaning, AnEdgeWithConnectedEndsIsSplitAtItsMiddle) {
  // Two wedges meet at the edge from 0 to 1. Other triangles connect them around both of its ends.
  TriangleMesh mesh;
  mesh.positions = {{0, 0, 0}, {0, 0, 1}};
  for (const double degrees : {90.0, 60.0, 270.0, 240.0}) {
    const double angle = degrees * std::acos(-1.0) / 180;
    mesh.positions.push_back({static_cast<float>(std::cos(angle)), static_cast<float>(std::sin(angle)), 0.5f});
  }
  mesh.triangles = {{0, 1, 2}, {1, 0, 3}, {0, 1, 4}, {1, 0, 5}, {0, 2, 5}, {0, 4, 3}, {1, 3, 4}, {1, 5, 2}};
  EXPECT_EQ(count_edges(mesh).non_manifold_edges, 1u);
  EXPECT_EQ(count_edges(mesh).boundary_edges, 0u);
  EXPECT_EQ(split_non_manifold(mesh), 1u);
  EXPECT_EQ(count_edges(mesh).non_manifold_edges, 0u);
  EXPECT_EQ(count_edges(mesh).boundary_edges, 0u);
  EXPECT_EQ(mesh.triangles.size(), 10u);
  EXPECT_EQ(mesh.positions.at(6).z, 0.5f);
  Vec3<double> sum{0, 0, 0};  // 0 for a closed surface
  for (const auto& triangle : mesh.triangles) sum = sum + mesh.area_normal(triangle);
  EXPECT_NEAR(dot(sum, sum), 0, 1e-12);
}

TEST(MeshCleaning, ATieOfTwoTrianglesIsSplit) {
  TriangleMesh mesh;
  mesh.positions = {{0, 0, 0}, {1, 1, 0}, {1, -1, 0}, {-1, 1, 0}, {-1, -1, 0}};
  mesh.triangles = {{0, 2, 1}, {0, 3, 4}};
  mesh.colors = {{1, 2, 3}, {}, {}, {}, {}};
  EXPECT_EQ(split_non_manifold(mesh), 1u);
  EXPECT_NE(mesh.triangles[0][0], mesh.triangles[1][0]);
  EXPECT_EQ(mesh.colors.at(5), (TriangleMesh::Color{1, 2, 3}));
  EXPECT_EQ(split_non_manifold(mesh), 0u);
}

TEST(MeshCleaning, TrianglesOfOppositeOrientationAreNotManifold) {
  TriangleMesh mesh;
  mesh.positions = {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {0, 0, 1}};
  mesh.triangles = {{0, 1, 2}, {0, 1, 3}};
  EXPECT_EQ(count_edges(mesh).non_manifold_edges, 1u);
  EXPECT_EQ(count_edges(mesh).boundary_edges, 4u);
  EXPECT_EQ(split_non_manifold(mesh), 2u);
  EXPECT_EQ(count_edges(mesh).boundary_edges, 6u);
}

TEST(MeshCleaning, SmallComponentsAreRemoved) {
  TriangleMesh mesh;
  append_ball({0, 0, 0}, 1, mesh);
  const std::size_t n = mesh.triangles.size();
  append_ball({5, 0, 0}, 0.05, mesh);
  append_ball({0, 5, 0}, 0.2, mesh);
  const Components components = remove_small_components(mesh, 0.01);
  EXPECT_EQ(components.kept, 2u);
  EXPECT_EQ(components.removed, 1u);
  EXPECT_EQ(mesh.triangles.size(), 2 * n);
  for (const Vec3f& position : mesh.positions) EXPECT_LT(position.x, 2);
}

TEST(MeshCleaning, CropKeepsTrianglesInside) {
  TriangleMesh mesh;
  append_ball({0, 0, 0}, 1, mesh);
  set_normals(mesh);
  crop(mesh, [](const std::array<double, 3>& p) { return p[2] > 0; });
  ASSERT_FALSE(mesh.triangles.empty());
  EXPECT_EQ(mesh.normals.size(), mesh.positions.size());
  for (const Vec3f& position : mesh.positions) EXPECT_GT(position.z, 0);
  crop(mesh, [](const auto&) { return false; });
  EXPECT_TRUE(mesh.positions.empty());
}

TEST(MeshCleaning, NormalsOfABallAreRadial) {
  TriangleMesh mesh;
  append_ball({0, 0, 0}, 2, mesh);
  set_normals(mesh);
  for (std::size_t i = 0; i < mesh.normals.size(); ++i) {
    const Vec3f &p = mesh.positions[i], &n = mesh.normals[i];
    if (std::abs(p.z) < 1.99f) {
      EXPECT_GT(dot(p, n), 2 * 0.9998f);
    }
  }
}

TEST(MeshCleaning, DecimationLeavesSoManyTriangles) {
  TriangleMesh mesh;
  append_ring({0, 0, 0}, 1, 0.3, mesh);
  const std::size_t n = mesh.triangles.size();
  EXPECT_EQ(decimate(mesh, n), 0) << "nothing to do";
  EXPECT_EQ(mesh.triangles.size(), n);
  const double error = decimate(mesh, n / 10);
  EXPECT_GT(error, 0);
  EXPECT_LT(error, 0.02);
  EXPECT_LE(mesh.triangles.size(), n / 10);
  EXPECT_GT(mesh.triangles.size(), n / 12);
}

TEST(MeshCleaning, DecimationLeavesNoFolds) {
  TriangleMesh mesh;
  append_ball({0, 0, 0}, 1, mesh);
  append_ring({5, 0, 0}, 1, 0.001, mesh);  // collapses to triangles that lie on each other
  decimate(mesh, 4);
  std::set<TriangleMesh::Triangle> sets_of_vertices;
  for (TriangleMesh::Triangle triangle : mesh.triangles) {
    std::sort(triangle.begin(), triangle.end());
    EXPECT_TRUE(sets_of_vertices.insert(triangle).second);
  }
}

TEST(MeshCleaning, AnEmptyMeshStaysEmpty) {
  TriangleMesh mesh;
  EXPECT_EQ(remove_small_components(mesh, 0.01).kept, 0u);
  EXPECT_EQ(split_non_manifold(mesh), 0u);
  EXPECT_EQ(decimate(mesh, 0), 0);
  set_normals(mesh);
  EXPECT_TRUE(mesh.triangles.empty());
}

}  // namespace
}  // namespace b3dgs
