#include "app/mesh/vertex_colors.h"

#include <algorithm>
#include <array>
#include <cmath>

#include "core/check.h"
#include "core/parallel.h"

namespace b3dgs {
namespace {

using Sum = std::array<float, 4>;  // weighted colour, weight

using ColorF = std::array<float, 3>;

void add(const ColorF& color, float weight, Sum& sum) {
  for (std::size_t c = 0; c < 3; ++c) sum[c] += weight * color[c];
  sum[3] += weight;
}

/// Interpolates bilinearly. The position is in pixels.
ColorF color_at(const Image8& image, double x, double y) {
  const double u = std::clamp(x - 0.5, 0.0, image.width - 1.0), v = std::clamp(y - 0.5, 0.0, image.height - 1.0);
  const int left = static_cast<int>(u), top = static_cast<int>(v);
  const int right = std::min(left + 1, image.width - 1), bottom = std::min(top + 1, image.height - 1);
  const double s = u - left, t = v - top;
  ColorF color{};
  for (int c = 0; c < 3; ++c) {
    const double upper = (1 - s) * image.at(left, top)[c] + s * image.at(right, top)[c];
    const double lower = (1 - s) * image.at(left, bottom)[c] + s * image.at(right, bottom)[c];
    color[static_cast<std::size_t>(c)] = static_cast<float>((1 - t) * upper + t * lower);
  }
  return color;
}

void add_view(const TriangleMesh& mesh, const DepthView& view, const Image8& photograph, double tolerance,
              std::vector<Sum>& sums) {
  const Camera& camera = view.camera;
  const double scale_x = static_cast<double>(photograph.width) / camera.width;
  const double scale_y = static_cast<double>(photograph.height) / camera.height;
  const std::array<double, 3> center = camera.center();
  parallel_each(static_cast<std::int64_t>(sums.size()), 4096, [&](std::int64_t row) {
    const auto i = static_cast<std::size_t>(row);
    const Vec3<double> at = mesh.position(static_cast<std::uint32_t>(i));
    const auto seen = camera.project(&at.x);
    if (!seen) return;
    const double depth = view.depth[view.index(static_cast<int>(seen->x), static_cast<int>(seen->y))];
    if (!(depth > 0 && std::abs(depth - seen->depth) <= tolerance)) return;
    const Vec3<double> ray = at - Vec3<double>{center[0], center[1], center[2]};
    const Vec3f& n = mesh.normals[i];
    const double cosine = -dot(ray, Vec3<double>{n.x, n.y, n.z}) / std::sqrt(dot(ray, ray));
    if (!(cosine > 0)) return;
    const ColorF color = color_at(photograph, scale_x * seen->x, scale_y * seen->y);
    add(color, static_cast<float>(cosine * cosine / (seen->depth * seen->depth)), sums[i]);
  });
}

/// Gives vertices without a colour the mean of their neighbours', ring by ring. A part without any colour stays so.
void fill_from_neighbors(const TriangleMesh& mesh, std::vector<Sum>& sums) {
  for (bool has_changed = true; has_changed;) {
    has_changed = false;
    std::vector<Sum> found(sums.size());
    for (const TriangleMesh::Triangle& triangle : mesh.triangles) {
      for (const std::uint32_t to : triangle) {
        if (sums[to][3] > 0) continue;
        for (const std::uint32_t from : triangle) {
          const Sum& sum = sums[from];
          if (!(sum[3] > 0)) continue;
          add({sum[0] / sum[3], sum[1] / sum[3], sum[2] / sum[3]}, 1, found[to]);
          has_changed = true;
        }
      }
    }
    for (std::size_t i = 0; i < sums.size(); ++i) {
      if (found[i][3] > 0) sums[i] = found[i];
    }
  }
}

}  // namespace

double color_vertices(TriangleMesh& mesh, const std::vector<DepthView>& views, const PhotographOf& photograph,
                      double tolerance) {
  B3DGS_CHECK(mesh.normals.size() == mesh.positions.size(), "a mesh without normals");
  std::vector<Sum> sums(mesh.positions.size());
  for (std::size_t i = 0; i < views.size(); ++i) add_view(mesh, views[i], photograph(i), tolerance, sums);
  const auto n_seen = std::count_if(sums.begin(), sums.end(), [](const Sum& sum) { return sum[3] > 0; });
  fill_from_neighbors(mesh, sums);
  mesh.colors.assign(sums.size(), {128, 128, 128});
  for (std::size_t i = 0; i < sums.size(); ++i) {
    if (!(sums[i][3] > 0)) continue;
    for (std::size_t c = 0; c < 3; ++c) {
      mesh.colors[i][c] = static_cast<std::uint8_t>(std::clamp(std::lround(sums[i][c] / sums[i][3]), 0L, 255L));
    }
  }
  return sums.empty() ? 0 : static_cast<double>(n_seen) / static_cast<double>(sums.size());
}

}  // namespace b3dgs
