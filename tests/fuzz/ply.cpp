// PLY files, read as meshes, as Gaussians and as points.
#include <cmath>
#include <optional>

#include "fuzz/fuzz_target.h"
#include "fuzz/splat_check.h"
#include "model/formats/splat_formats.h"
#include "model/formats/triangle_mesh.h"

namespace b3dgs::fuzz {
namespace {

void check_points(const WorldPoints& points) {
  B3DGS_CHECK(points.positions.size() == points.colors.size(), "positions and colours differ in length");
  for (const float value : points.positions)
    B3DGS_CHECK(std::isfinite(value), "expected a finite value, found ", value);
}

void check_mesh(std::string_view bytes) {
  TriangleMesh mesh;
  try {
    FileReader file("a.ply", bytes);
    mesh = read_mesh_ply(file);
  } catch (const InputError&) {
    return;
  }
  for (const TriangleMesh::Triangle& triangle : mesh.triangles) {
    for (const std::uint32_t vertex : triangle) {
      B3DGS_CHECK(vertex < mesh.positions.size(), "vertex ", vertex, " of ", mesh.positions.size());
    }
  }
}

}  // namespace

void read_input(std::string_view bytes) {
  check_mesh(bytes);
  std::optional<InputError> refused;
  try {
    FileReader file("a.ply", bytes);
    check_splats(read_splat_ply(file));
  } catch (const InputError& error) {
    refused = error;
  }
  FileReader file("a.ply", bytes);
  WorldPoints points;
  try {
    points = read_point_ply(file);
  } catch (const InputError&) {
    if (refused) throw;
    return;
  }
  check_points(points);
}

}  // namespace b3dgs::fuzz
