#include "scene/points/point_cloud.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstring>

#include "core/check.h"
#include "core/files/atomic_file.h"
#include "core/files/file_reader.h"
#include "core/files/ply_reader.h"

namespace b3dgs {
namespace {

constexpr std::int64_t kRowsPerBlock = 4096;

template <class Value>
void write_rows(AtomicFile& file, const WorldPoints& points) {
  constexpr std::size_t kRowBytes = 3 * sizeof(Value) + 3;
  const std::int64_t n = points.size();
  const char* const type = sizeof(Value) == sizeof(float) ? "float" : "double";
  file.write(
      ply_header(n, {{"x", type}, {"y", type}, {"z", type}, {"red", "uchar"}, {"green", "uchar"}, {"blue", "uchar"}}));
  std::vector<char> block;
  for (std::int64_t begin = 0; begin < n; begin += kRowsPerBlock) {
    const std::int64_t end = std::min(n, begin + kRowsPerBlock);
    block.resize(static_cast<std::size_t>(end - begin) * kRowBytes);
    char* to = block.data();
    for (std::int64_t row = begin; row < end; ++row, to += kRowBytes) {
      const double* const from = points.positions.data() + 3 * row;
      const Value position[3]{static_cast<Value>(from[0]), static_cast<Value>(from[1]), static_cast<Value>(from[2])};
      std::memcpy(to, position, sizeof position);
      std::memcpy(to + sizeof position, points.colors.data() + 3 * row, 3);
    }
    file.write(block.data(), block.size());
  }
}

}  // namespace

PointCloud in_frame(const CoordinateFrame& frame, const WorldPoints& points) {
  PointCloud cloud{{}, points.colors};
  cloud.positions.reserve(points.positions.size());
  for (std::size_t i = 0; i < points.positions.size(); i += 3) {
    for (const double value : frame.from_world(&points.positions[i])) {
      cloud.positions.push_back(static_cast<float>(value));
    }
  }
  return cloud;
}

WorldPoints in_world(const CoordinateFrame& frame, const PointCloud& points) {
  WorldPoints world{{}, points.colors};
  world.positions.reserve(points.positions.size());
  for (std::size_t i = 0; i < points.positions.size(); i += 3) {
    const std::array<double, 3> position = frame.to_world(&points.positions[i]);
    world.positions.insert(world.positions.end(), position.begin(), position.end());
  }
  return world;
}

std::string ply_header(std::int64_t n_vertices, const std::vector<std::pair<std::string, const char*>>& properties,
                       const std::string& comment) {
  std::string text = "ply\nformat binary_little_endian 1.0\n";
  if (!comment.empty()) text += "comment " + comment + "\n";
  text += detail::concat("element vertex ", n_vertices, "\n");
  for (const auto& [name, type] : properties) text += detail::concat("property ", type, " ", name, "\n");
  return text + "end_header\n";
}

void refuse_other_ply(const PlyReader& reader) {
  const PlyElement& vertices = reader.vertices();
  if (vertices.find("packed_position")) {
    input_error(reader.name(),
                ": compressed PLY of SuperSplat is not supported; open it there and export it as PLY, or "
                "use splat-transform IN.compressed.ply OUT.ply");
  }
  if (vertices.find("f_dc_0") && vertices.find("scale_1") && !vertices.find("scale_2")) {
    input_error(
        reader.name(),
        ": expected scale_0, scale_1 and scale_2 of 3D Gaussian Splatting, found two scales: it is a model of 2D "
        "Gaussian Splatting");
  }
}

void write_point_ply(const std::filesystem::path& path, const PointCloud& points, const CoordinateFrame& frame) {
  B3DGS_CHECK(points.positions.size() == points.colors.size(), points.positions.size(), " coordinates, ",
              points.colors.size(), " colour values");
  AtomicFile file(path);
  const WorldPoints world = in_world(frame, points);
  frame.is_far() ? write_rows<double>(file, world) : write_rows<float>(file, world);
  file.commit();
}

WorldPoints read_point_ply(const std::filesystem::path& path) {
  FileReader file(path);
  return read_point_ply(file);
}

WorldPoints read_point_ply(FileReader& file) {
  PlyReader reader(file);
  refuse_other_ply(reader);
  const PlyElement& vertices = reader.vertices();
  std::vector<std::string> columns{"x", "y", "z"};
  const PlyProperty* red = vertices.find("red");
  double to_8_bits = 0;
  if (red) {
    for (const char* name : {"red", "green", "blue"}) columns.emplace_back(name);
    to_8_bits = red->type >= PlyType::kFloat32 ? 255.0 : red->type == PlyType::kUint16 ? 1.0 / 257.0 : 1.0;
  }
  WorldPoints points;
  points.positions.resize(vertices.count * 3);
  points.colors.assign(vertices.count * 3, 128);
  reader.read_vertices(columns, [&](std::uint64_t first, std::uint64_t n_rows, const double* rows) {
    for (std::uint64_t i = 0; i < n_rows; ++i) {
      const double* row = rows + i * columns.size();
      for (std::size_t k = 0; k < columns.size(); ++k) {
        if (!std::isfinite(static_cast<float>(row[k]))) {
          input_error(reader.name(), ": row ", first + i, " (counted from 0): expected a finite ", columns[k],
                      ", found ", row[k], "; remove this point or export the file again");
        }
        const std::uint64_t at = (first + i) * 3;
        if (k < 3) {
          points.positions[at + k] = row[k];
        } else {
          points.colors[at + k - 3] =
              static_cast<std::uint8_t>(std::lround(std::clamp(row[k] * to_8_bits, 0.0, 255.0)));
        }
      }
    }
  });
  return points;
}

}  // namespace b3dgs
