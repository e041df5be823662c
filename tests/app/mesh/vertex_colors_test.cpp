#include "app/mesh/vertex_colors.h"

#include <gtest/gtest.h>

#include "app/mesh/mesh_cleaning.h"
#include "app/mesh/ray_cast_views.h"
#include "data_synth/truth_mesh.h"

namespace b3dgs {
namespace {

/// Makes a photograph whose upper half is red and whose lower half is green.
Image8 two_halves(int width, int height) {
  Image8 image(width, height, 3);
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) image.at(x, y)[y < height / 2 ? 0 : 1] = 200;
  }
  return image;
}

/// Makes a ball that a camera at z = -4 sees, whose image has +y below.
test::SolidScene ball_in_front() {
  test::SolidScene scene{{}, {Camera::with_field_of_view(60, 60, 40, {{1, 0, 0, 0, 1, 0, 0, 0, 1}, {0, 0, 4}})}};
  append_ball({0, 0, 0}, 1, scene.surface);
  return scene;
}

TEST(VertexColors, AreThoseOfThePhotograph) {
  test::SolidScene scene = ball_in_front();
  TriangleMesh& mesh = scene.surface;
  const std::vector<DepthView> views = test::ray_cast_views(scene);
  set_normals(mesh);
  // The photograph has twice the size of the depth image.
  const double share = color_vertices(
      mesh, views, [](std::size_t) { return two_halves(120, 120); }, 0.05);
  EXPECT_GT(share, 0.25);
  EXPECT_LT(share, 0.5);
  for (std::size_t i = 0; i < mesh.positions.size(); ++i) {
    const Vec3f& p = mesh.positions[i];
    if (p.z > -0.6f) continue;  // seen at a grazing angle, or not at all
    if (p.y < -0.05f) {
      EXPECT_EQ(mesh.colors[i], (TriangleMesh::Color{200, 0, 0}));
    }
    if (p.y > 0.05f) {
      EXPECT_EQ(mesh.colors[i], (TriangleMesh::Color{0, 200, 0}));
    }
  }
}

TEST(VertexColors, OfUnseenVerticesAreTheirNeighbors) {
  test::SolidScene scene = ball_in_front();
  TriangleMesh& mesh = scene.surface;
  const std::vector<DepthView> views = test::ray_cast_views(scene);
  set_normals(mesh);
  const auto grey = [](std::size_t) {
    Image8 image(60, 60, 3);
    for (std::uint8_t& value : image.pixels) value = 77;
    return image;
  };
  color_vertices(mesh, views, grey, 0.05);
  std::vector<char> is_used(mesh.positions.size());
  for (const TriangleMesh::Triangle& triangle : mesh.triangles) {
    for (const std::uint32_t vertex : triangle) is_used[vertex] = 1;
  }
  for (std::size_t i = 0; i < mesh.colors.size(); ++i) {
    if (is_used[i]) {
      EXPECT_EQ(mesh.colors[i], (TriangleMesh::Color{77, 77, 77}));
    }
  }
}

}  // namespace
}  // namespace b3dgs
