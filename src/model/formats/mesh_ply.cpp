#include <cmath>
#include <string>

#include "core/check.h"
#include "core/files/atomic_file.h"
#include "core/files/ply_reader.h"
#include "core/text.h"
#include "model/formats/triangle_mesh.h"

namespace b3dgs {
namespace {

constexpr std::size_t kBytesPerWrite = 1 << 20;

/// Appends a value in memory order, which ply.cpp checks to be little-endian.
template <class Value>
void append_value(std::string& bytes, const Value& value) {
  bytes.append(reinterpret_cast<const char*>(&value), sizeof value);
}

std::string mesh_header(const TriangleMesh& mesh, bool is_far) {
  std::string text = "ply\nformat binary_little_endian 1.0\ncomment b3dgs\n";
  text += detail::concat("element vertex ", mesh.positions.size(), "\n");
  const auto add = [&](const char* type, std::initializer_list<const char*> names) {
    for (const char* name : names) text += detail::concat("property ", type, " ", name, "\n");
  };
  add(is_far ? "double" : "float", {"x", "y", "z"});
  if (!mesh.normals.empty()) add("float", {"nx", "ny", "nz"});
  if (!mesh.colors.empty()) add("uchar", {"red", "green", "blue"});
  return text + detail::concat("element face ", mesh.triangles.size(),
                               "\nproperty list uchar uint vertex_indices\nend_header\n");
}

}  // namespace

void write_mesh_ply(const std::filesystem::path& path, const TriangleMesh& mesh, const CoordinateFrame& frame) {
  AtomicFile file(path);
  std::string bytes = mesh_header(mesh, frame.is_far());
  const auto flush = [&](std::size_t at_least) {
    if (bytes.size() < at_least) return;
    file.write(bytes);
    bytes.clear();
  };
  for (std::size_t i = 0; i < mesh.positions.size(); ++i) {
    for (const double value : frame.to_world(&mesh.positions[i].x)) {
      frame.is_far() ? append_value(bytes, value) : append_value(bytes, static_cast<float>(value));
    }
    if (!mesh.normals.empty()) append_value(bytes, mesh.normals[i]);
    if (!mesh.colors.empty()) append_value(bytes, mesh.colors[i]);
    flush(kBytesPerWrite);
  }
  for (const TriangleMesh::Triangle& triangle : mesh.triangles) {
    append_value(bytes, std::uint8_t{3});
    append_value(bytes, triangle);
    flush(kBytesPerWrite);
  }
  flush(1);
  file.commit();
}

TriangleMesh read_mesh_ply(const std::filesystem::path& path, const CoordinateFrame& frame) {
  FileReader file(path);
  return read_mesh_ply(file, frame);
}

TriangleMesh read_mesh_ply(FileReader& file, const CoordinateFrame& frame) {
  PlyReader reader(file);
  TriangleMesh mesh;
  reader.read_vertices({"x", "y", "z"}, [&](std::uint64_t first, std::uint64_t n_rows, const double* values) {
    for (std::uint64_t row = 0; row < n_rows; ++row, values += 3) {
      const std::array<double, 3> p = frame.from_world(values);
      mesh.positions.push_back({static_cast<float>(p[0]), static_cast<float>(p[1]), static_cast<float>(p[2])});
      const Vec3f& stored = mesh.positions.back();
      if (std::isfinite(stored.x) && std::isfinite(stored.y) && std::isfinite(stored.z)) continue;
      input_error(reader.name(), ": expected finite coordinates, found ", values[0], " ", values[1], " ", values[2],
                  " at vertex ", first + row + 1, "; export the mesh again");
    }
  });

  double area = 0;
  reader.read_lists("face", {"vertex_indices", "vertex_index"}, [&](std::uint64_t row, const auto& corners) {
    for (const double corner : corners) {
      if (corner >= 0 && corner < static_cast<double>(mesh.positions.size()) && corner == std::floor(corner)) continue;
      input_error(reader.name(), ": expected a vertex from 0 to ", mesh.positions.size() - 1, ", found ", corner,
                  " in face ", row + 1, "; the file is damaged");
    }
    for (std::size_t i = 2; i < corners.size(); ++i) {
      mesh.triangles.push_back({static_cast<std::uint32_t>(corners[0]), static_cast<std::uint32_t>(corners[i - 1]),
                                static_cast<std::uint32_t>(corners[i])});
      const Vec3<double> normal = mesh.area_normal(mesh.triangles.back());
      area += 0.5 * std::sqrt(dot(normal, normal));
    }
  });
  if (mesh.triangles.empty()) {
    input_error(reader.name(), ": expected a mesh, found a file without faces; a point cloud does not have a surface");
  }
  if (!(area > 0)) {
    input_error(reader.name(), ": expected a mesh with an area, found ", format_count(mesh.triangles.size()),
                " triangles whose area is 0; export the mesh again");
  }
  return mesh;
}

}  // namespace b3dgs
