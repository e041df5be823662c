#include "app/mesh/mesh_distance.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "app/mesh/triangle_scene.h"
#include "core/parallel.h"
#include "core/random.h"

namespace b3dgs {
namespace {

using Vec = Vec3<double>;

constexpr std::int64_t kPointGrain = 256;
constexpr int kLeastViews = 2;
constexpr double kLeastCosine80 = 0.17364817766693033;
constexpr float kBeforePoint = 1 - 1e-4f;  // the end of a ray to a point, in front of the surface that it is on

struct SurfacePoints {
  std::vector<Vec> positions, normals;
};

Vec unit_normal(const TriangleMesh& mesh, std::uint32_t triangle) {
  const Vec normal = mesh.area_normal(mesh.triangles[triangle]);
  const double length = std::sqrt(dot(normal, normal));
  return length > 0 ? (1 / length) * normal : Vec{0, 0, 1};
}

/// Returns n points, one in each n-th part of the area.
SurfacePoints sample_surface(const TriangleMesh& mesh, std::int64_t n) {
  std::vector<double> areas;  // up to and including each triangle
  double area = 0;
  for (const TriangleMesh::Triangle& triangle : mesh.triangles) {
    const Vec normal = mesh.area_normal(triangle);
    areas.push_back(area += std::sqrt(dot(normal, normal)));
  }
  const auto size = static_cast<std::size_t>(n);
  SurfacePoints points{std::vector<Vec>(size), std::vector<Vec>(size)};
  parallel_each(n, kPointGrain, [&](std::int64_t i) {
    const auto random = random_uniform({0, RandomStream::kSurfacePoints, 0}, static_cast<std::uint64_t>(i));
    const double place = (static_cast<double>(i) + random[0]) / static_cast<double>(n) * area;
    const auto found = std::upper_bound(areas.begin(), areas.end() - 1, place);
    const auto triangle = static_cast<std::uint32_t>(found - areas.begin());
    const TriangleMesh::Triangle& t = mesh.triangles[triangle];
    const double root = std::sqrt(random[1]), share = random[2];
    points.positions[static_cast<std::size_t>(i)] = (1 - root) * mesh.position(t[0]) +
                                                    (root * (1 - share)) * mesh.position(t[1]) +
                                                    (root * share) * mesh.position(t[2]);
    points.normals[static_cast<std::size_t>(i)] = unit_normal(mesh, triangle);
  });
  return points;
}

/// Removes the points for which keeps(row) is false.
template <class Keeps>
void keep_points(SurfacePoints& points, const Keeps& keeps) {
  std::vector<char> is_kept(points.positions.size());
  parallel_each(static_cast<std::int64_t>(is_kept.size()), kPointGrain, [&](std::int64_t i) {
    is_kept[static_cast<std::size_t>(i)] = keeps(static_cast<std::size_t>(i)) ? 1 : 0;
  });
  std::size_t n = 0;
  for (std::size_t i = 0; i < is_kept.size(); ++i) {
    if (!is_kept[i]) continue;
    points.positions[n] = points.positions[i];
    points.normals[n++] = points.normals[i];
  }
  points.positions.resize(n);
  points.normals.resize(n);
}

bool is_seen(const Vec& point, const Vec& normal, const std::vector<Camera>& cameras, const TriangleScene& surface) {
  int n_views = 0;
  for (const Camera& camera : cameras) {
    if (!camera.project(&point.x)) continue;
    const std::array<double, 3> center = camera.center();
    const Vec eye{center[0], center[1], center[2]}, ray = point - eye;
    if (-dot(normal, ray) < kLeastCosine80 * std::sqrt(dot(ray, ray))) continue;
    const auto in_floats = [](const Vec& v) {
      return Vec3f{static_cast<float>(v.x), static_cast<float>(v.y), static_cast<float>(v.z)};
    };
    if (!surface.first_hit(in_floats(eye), in_floats(ray), kBeforePoint) && ++n_views == kLeastViews) return true;
  }
  return false;
}

SurfaceDistance measure(const SurfacePoints& points, const TriangleScene& to, const TriangleMesh& mesh,
                        double threshold) {
  SurfaceDistance result;
  const std::size_t n = points.positions.size();
  result.n_points = static_cast<std::int64_t>(n);
  if (n == 0) return result;
  std::vector<double> distances(n), degrees(n);
  parallel_each(result.n_points, kPointGrain, [&](std::int64_t row) {
    const auto i = static_cast<std::size_t>(row);
    const TriangleScene::Nearest nearest = to.nearest(points.positions[i]);
    distances[i] = nearest.distance;
    const double cosine = dot(points.normals[i], unit_normal(mesh, nearest.triangle));
    degrees[i] = std::acos(std::clamp(cosine, -1.0, 1.0)) / kDegree;
  });
  for (std::size_t i = 0; i < n; ++i) {  // in this order, so that rounding does not depend on the number of threads
    result.mean += distances[i];
    result.share += distances[i] <= threshold ? 1 : 0;
    result.share_of_half += distances[i] <= 0.5 * threshold ? 1 : 0;
    result.degrees += degrees[i];
  }
  for (double* sum : {&result.mean, &result.share, &result.share_of_half, &result.degrees}) {
    *sum /= static_cast<double>(n);
  }
  const auto at = distances.begin() + static_cast<std::ptrdiff_t>(n * 95 / 100);
  std::nth_element(distances.begin(), at, distances.end());
  result.p95 = *at;
  return result;
}

}  // namespace

MeshQuality compare_meshes(const TriangleMesh& mesh, const TriangleMesh& truth, const std::vector<Camera>& cameras,
                           double threshold, std::int64_t n_points) {
  const TriangleScene mesh_scene(mesh), truth_scene(truth);
  constexpr double kInfinity = std::numeric_limits<double>::infinity();
  Vec low{kInfinity, kInfinity, kInfinity}, high{-kInfinity, -kInfinity, -kInfinity};
  for (std::uint32_t i = 0; i < truth.positions.size(); ++i) {
    const Vec p = truth.position(i);
    low = {std::min(low.x, p.x), std::min(low.y, p.y), std::min(low.z, p.z)};
    high = {std::max(high.x, p.x), std::max(high.y, p.y), std::max(high.z, p.z)};
  }
  SurfacePoints of_mesh = sample_surface(mesh, n_points), of_truth = sample_surface(truth, n_points);
  keep_points(of_mesh, [&](std::size_t i) {
    const Vec &p = of_mesh.positions[i], under = p - low, over = high - p;
    return std::min({under.x, under.y, under.z, over.x, over.y, over.z}) >= -threshold;
  });
  if (!cameras.empty()) {
    keep_points(of_truth, [&](std::size_t i) {
      return is_seen(of_truth.positions[i], of_truth.normals[i], cameras, truth_scene);
    });
  }
  return {measure(of_mesh, truth_scene, truth, threshold), measure(of_truth, mesh_scene, mesh, threshold)};
}

}  // namespace b3dgs
