// A triangle mesh in memory, and its PLY files.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <vector>

#include "core/files/file_reader.h"
#include "core/vec.h"
#include "scene/cameras/coordinate_frame.h"

namespace b3dgs {

struct TriangleMesh {
  using Triangle = std::array<std::uint32_t, 3>;  // vertices, counter-clockwise as seen from outside
  using Color = std::array<std::uint8_t, 3>;      // RGB

  std::vector<Vec3f> positions;
  std::vector<Triangle> triangles;
  std::vector<Vec3f> normals;  // unit length, one per vertex, or empty
  std::vector<Color> colors;   // one per vertex, or empty

  Vec3<double> position(std::uint32_t vertex) const {
    const Vec3f& p = positions[vertex];
    return {p.x, p.y, p.z};
  }
  /// Returns the normal of a triangle times twice its area.
  Vec3<double> area_normal(const Triangle& t) const {
    const Vec3<double> a = position(t[0]);
    return cross(position(t[1]) - a, position(t[2]) - a);
  }
};

/// Writes positions, normals and colours (if there are any) and triangles, atomically. Positions are in `frame`, and
/// the file has world coordinates. @throws IoError
void write_mesh_ply(const std::filesystem::path& path, const TriangleMesh& mesh, const CoordinateFrame& frame = {});

/// Reads positions and faces, which it cuts into triangles. @throws InputError if the file is damaged, or has no face,
/// no area, or a position that is not a finite number
TriangleMesh read_mesh_ply(const std::filesystem::path& path, const CoordinateFrame& frame = {});
TriangleMesh read_mesh_ply(FileReader& file, const CoordinateFrame& frame = {});

}  // namespace b3dgs
