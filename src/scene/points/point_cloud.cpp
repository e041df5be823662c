#include "scene/points/point_cloud.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>

#include "core/check.h"
#include "core/files/atomic_file.h"
#include "core/files/file_reader.h"
#include "core/files/ply_reader.h"

namespace b3dgs {
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
  if (vertices.find("scale_1") && !vertices.find("scale_2")) {
    input_error(
        reader.name(),
        ": expected scale_0, scale_1 and scale_2 of 3D Gaussian Splatting, found two scales: it is a model of 2D "
        "Gaussian Splatting");
  }
}

void write_point_ply(const std::filesystem::path& path, const PointCloud& points, const CoordinateFrame& frame) {
  B3DGS_CHECK(points.positions.size() == points.colors.size(), points.positions.size(), " coordinates, ",
              points.colors.size(), " colour values");
  const bool is_far = frame.is_far();
  const char* const type = is_far ? "double" : "float";
  std::string bytes = ply_header(
      points.size(), {{"x", type}, {"y", type}, {"z", type}, {"red", "uchar"}, {"green", "uchar"}, {"blue", "uchar"}});
  const auto put = [&](auto value) { bytes.append(reinterpret_cast<const char*>(&value), sizeof value); };
  for (std::size_t i = 0; i < points.positions.size(); i += 3) {
    for (const double value : frame.to_world(&points.positions[i])) {
      is_far ? put(value) : put(static_cast<float>(value));
    }
    bytes.append(reinterpret_cast<const char*>(&points.colors[i]), 3);
  }
  write_file(path, bytes);
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
    to_8_bits = color_factor(*red);
  }
  WorldPoints points;
  points.positions.resize(vertices.count * 3);
  points.colors.assign(vertices.count * 3, 128);
  std::size_t n = 0;  // number of values of kept points
  reader.read_vertices(columns, [&](std::uint64_t first, std::uint64_t n_rows, const double* values) {
    for (std::uint64_t row = first; row < first + n_rows; ++row, values += columns.size()) {
      const double* const end = values + columns.size();
      const double* const bad =
          std::find_if_not(values, end, [](double value) { return std::isfinite(static_cast<float>(value)); });
      if (bad != end) {
        if (!points.left_out.empty()) continue;
        points.left_out = detail::concat(reader.name(), ": row ", row, " (counted from 0): expected a finite ",
                                         columns[static_cast<std::size_t>(bad - values)], ", found ", *bad);
        continue;
      }
      for (std::size_t k = 0; k < columns.size(); ++k) {
        if (k < 3) {
          points.positions[n + k] = values[k];
        } else {
          const double color = std::clamp(values[k] * to_8_bits, 0.0, 255.0);
          points.colors[n + k - 3] = static_cast<std::uint8_t>(std::lround(color));
        }
      }
      n += 3;
    }
  });
  if (points.left_out.empty()) return points;
  if (n == 0) input_error(points.left_out, "; export the file again");
  points.left_out += detail::concat("; ", vertices.count - n / 3, " of ", vertices.count, " points are left out");
  points.positions.resize(n);
  points.colors.resize(n);
  return points;
}

}  // namespace b3dgs
