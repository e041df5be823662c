#include "app/mesh/mesh_files.h"

#include <gtest/gtest.h>
#include <tiny_gltf.h>

#include <array>
#include <cmath>
#include <string>

#include "support/expect_error.h"
#include "support/files.h"
#include "support/temp_dir.h"

namespace b3dgs {
namespace {

using test::fails_with;
using test::write_bytes;

const CoordinateFrame kFar{{4000000, 500000, 20}, 0.5};  // of map coordinates

TriangleMesh tetrahedron() {
  TriangleMesh mesh;
  mesh.positions = {{0, 0, 0}, {1.25f, 0, 0}, {0, 1, 0}, {0, 0, -1}};
  mesh.triangles = {{0, 1, 2}, {0, 3, 1}, {0, 2, 3}, {1, 3, 2}};
  mesh.normals = {{0, 0, 1}, {1, 0, 0}, {0, 1, 0}, {0, 0, -1}};
  mesh.colors = {{255, 0, 0}, {0, 128, 0}, {0, 0, 255}, {9, 8, 7}};
  return mesh;
}

void expect_positions(const TriangleMesh& found, const TriangleMesh& expected) {
  ASSERT_EQ(found.positions.size(), expected.positions.size());
  for (std::size_t i = 0; i < found.positions.size(); ++i) {
    EXPECT_EQ(found.positions[i].x, expected.positions[i].x);
    EXPECT_EQ(found.positions[i].y, expected.positions[i].y);
    EXPECT_EQ(found.positions[i].z, expected.positions[i].z);
  }
  EXPECT_EQ(found.triangles, expected.triangles);
}

/// Returns an ASCII PLY of a square with these faces.
std::string square(const std::string& faces, int n_faces, const std::string& corner = "1 1 0") {
  return "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n"
         "element face " +
         std::to_string(n_faces) + "\nproperty uchar quality\nproperty list uchar int vertex_index\nend_header\n" +
         "0 0 0\n1 0 0\n" + corner + "\n0 1 0\n" + faces;
}

TEST(MeshFiles, PlyIsReadBack) {
  const test::TempDir folder;
  write_mesh(folder / "mesh.ply", tetrahedron());
  expect_positions(read_mesh_ply(folder / "mesh.ply"), tetrahedron());
  const std::string bytes = test::read_bytes(folder / "mesh.ply");
  for (const char* part : {"property float nx", "property uchar blue", "element face 4"}) {
    EXPECT_TRUE(test::contains(bytes, part)) << part;
  }
  const std::size_t header = bytes.find("end_header\n") + 11;
  EXPECT_EQ(bytes.size() - header, 4 * 27 + 4 * 13u);
}

TEST(MeshFiles, FarCoordinatesKeepTheirDigits) {
  const test::TempDir folder;
  write_mesh(folder / "mesh.ply", tetrahedron(), kFar);
  expect_positions(read_mesh_ply(folder / "mesh.ply", kFar), tetrahedron());
  write_mesh(folder / "mesh.obj", tetrahedron(), kFar);
  EXPECT_TRUE(test::contains(test::read_bytes(folder / "mesh.obj"), "v 4000000.625 500000 20 "));
}

TEST(MeshFiles, ObjIsText) {
  const test::TempDir folder;
  write_mesh(folder / "MESH.OBJ", tetrahedron());
  const std::string text = test::read_bytes(folder / "MESH.OBJ");
  for (const char* line :
       {"v 1.25 0 0 0.0000 0.5020 0.0000\n", "vn 0.00000 0.00000 -1.00000\n", "f 1//1 4//4 2//2\n"}) {
    EXPECT_TRUE(test::contains(text, line)) << line;
  }
}

TEST(MeshFiles, GlbIsReadBack) {
  const test::TempDir folder;
  const TriangleMesh mesh = tetrahedron();
  write_mesh(folder / "mesh.glb", mesh, kFar, {{0, 0, 1}});
  tinygltf::Model model;
  std::string error, warning;
  ASSERT_TRUE(tinygltf::TinyGLTF().LoadBinaryFromFile(&model, &error, &warning, (folder / "mesh.glb").string()));
  EXPECT_EQ(error + warning, "");
  // A quarter of a turn about x brings +z to +y: (x, y, z) to (x, z, -y).
  const std::vector<double>& turn = model.nodes.at(0).rotation;  // x, y, z, w
  ASSERT_EQ(turn.size(), 4u);
  const double half = std::sqrt(0.5);
  for (std::size_t i = 0; i < 4; ++i) EXPECT_NEAR(turn[i], (std::array<double, 4>{-half, 0, 0, half}[i]), 1e-15);
  const std::vector<double>& origin = model.nodes.at(0).translation;
  ASSERT_EQ(origin.size(), 3u);
  for (std::size_t i = 0; i < 3; ++i) EXPECT_NEAR(origin[i], (std::array<double, 3>{4000000, 20, -500000}[i]), 1e-8);
  const tinygltf::Primitive& primitive = model.meshes.at(0).primitives.at(0);
  const auto data = [&](int accessor) {
    const tinygltf::BufferView& view = model.bufferViews.at(model.accessors.at(accessor).bufferView);
    return model.buffers.at(0).data.data() + view.byteOffset;
  };
  const auto* positions = reinterpret_cast<const float*>(data(primitive.attributes.at("POSITION")));
  EXPECT_EQ(positions[3], 0.625f) << "half a unit of the frame";
  EXPECT_EQ(model.accessors[0].minValues, (std::vector<double>{0, 0, -0.5}));
  EXPECT_EQ(data(primitive.attributes.at("COLOR_0"))[4 + 1], 128);
  EXPECT_EQ(model.accessors.at(primitive.indices).count, 12u);
  EXPECT_EQ(reinterpret_cast<const std::uint32_t*>(data(primitive.indices))[4], 3u);
}

TEST(MeshFiles, UnknownFormatsAreRefused) {
  for (const char* name : {"mesh.stl", "mesh", "mesh.ply.gz"}) {
    EXPECT_TRUE(fails_with<InputError>({name, ".ply, .obj or .glb"}, [&] { require_mesh_format(name); }));
  }
  require_mesh_format("a/B.Ply");
}

TEST(MeshFiles, PolygonsBecomeTriangles) {
  const test::TempDir folder;
  write_bytes(folder / "square.ply", square("7 4 0 1 2 3\n", 1));
  const TriangleMesh mesh = read_mesh_ply(folder / "square.ply");
  EXPECT_EQ(mesh.triangles, (std::vector<TriangleMesh::Triangle>{{0, 1, 2}, {0, 2, 3}}));
}

TEST(MeshFiles, DamagedPlyIsRefused) {
  const test::TempDir folder;
  const auto fails = [&](const std::string& content, std::initializer_list<std::string> parts) {
    write_bytes(folder / "mesh.ply", content);
    return fails_with<InputError>(parts, [&] { read_mesh_ply(folder / "mesh.ply"); });
  };
  EXPECT_TRUE(fails(square("", 0), {"mesh.ply", "without faces"}));
  EXPECT_TRUE(fails(square("7 3 0 1 4\n", 1), {"0 to 3", "found 4 in face 1"}));
  EXPECT_TRUE(fails(square("7 3 0 1 -1\n", 1), {"found -1"}));
  EXPECT_TRUE(fails(square("7 3 0 1 2\n", 2), {"row 2 of 2 of element face"}));
  EXPECT_TRUE(fails(square("7 3 0 1 2\n", 1, "nan 1 0"), {"finite", "vertex 3"}));
  EXPECT_TRUE(fails(square("7 3 0 1 1\n", 1), {"area is 0"}));
  std::string other = square("7 3 0 1 2\n", 1);
  other.replace(other.find("vertex_index"), 12, "strip");
  EXPECT_TRUE(fails(other, {"vertex_indices or vertex_index"}));
  write_mesh(folder / "whole.ply", tetrahedron());
  const std::string whole = test::read_bytes(folder / "whole.ply");
  for (const std::size_t size : {whole.size() - 1, whole.size() - 20, whole.size() - 60, whole.size() + 1}) {
    std::string part = whole;
    part.resize(size);
    EXPECT_TRUE(fails(part, {"mesh.ply"})) << size;
  }
}

}  // namespace
}  // namespace b3dgs
