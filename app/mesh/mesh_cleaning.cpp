#include "app/mesh/mesh_cleaning.h"

#include <meshoptimizer.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <numeric>
#include <set>
#include <utility>

namespace b3dgs {
namespace {

using Vec = Vec3<double>;
using Triangle = TriangleMesh::Triangle;

/// Disjoint sets of numbers. The representative of a set is its smallest number.
class Sets {
 public:
  explicit Sets(std::size_t n) : parents_(n) { std::iota(parents_.begin(), parents_.end(), 0u); }
  std::uint32_t find(std::uint32_t a) {
    while (parents_[a] != a) a = parents_[a] = parents_[parents_[a]];
    return a;
  }
  void join(std::uint32_t a, std::uint32_t b) {
    a = find(a);
    b = find(b);
    parents_[std::max(a, b)] = std::min(a, b);
  }

 private:
  std::vector<std::uint32_t> parents_;
};

// A corner is 3 * triangle + position, and stands also for the edge from it to the next corner of the triangle.
std::uint32_t next_corner(std::uint32_t corner) {
  return corner % 3 == 2 ? corner - 2 : corner + 1;
}
std::uint32_t vertex_at(const TriangleMesh& mesh, std::uint32_t corner) {
  return mesh.triangles[corner / 3][corner % 3];
}

struct Edge {
  std::uint32_t low, high;  // vertices
  std::uint32_t corner;
  bool is_same(const Edge& other) const { return low == other.low && high == other.high; }
};

/// Calls on_edge(edges of one pair of vertices, their number) in ascending order.
template <class OnEdge>
void for_edges(const TriangleMesh& mesh, const OnEdge& on_edge) {
  std::vector<Edge> edges;
  edges.reserve(3 * mesh.triangles.size());
  for (std::uint32_t corner = 0; corner < 3 * mesh.triangles.size(); ++corner) {
    const auto [low, high] = std::minmax({vertex_at(mesh, corner), vertex_at(mesh, next_corner(corner))});
    edges.push_back({low, high, corner});
  }
  std::sort(edges.begin(), edges.end(), [](const Edge& a, const Edge& b) {
    return a.low != b.low ? a.low < b.low : a.high != b.high ? a.high < b.high : a.corner < b.corner;
  });
  for (std::size_t begin = 0, end = 0; begin < edges.size(); begin = end) {
    while (end < edges.size() && edges[end].is_same(edges[begin])) ++end;
    on_edge(&edges[begin], end - begin);
  }
}

/// Keeps the triangles for which keeps(triangle) is true, and the vertices that they use.
template <class Keeps>
void keep_triangles(TriangleMesh& mesh, const Keeps& keeps) {
  const auto end = std::remove_if(mesh.triangles.begin(), mesh.triangles.end(),
                                  [&](const Triangle& triangle) { return !keeps(triangle); });
  mesh.triangles.erase(end, mesh.triangles.end());
  std::vector<std::uint32_t> ids(mesh.positions.size());
  for (const Triangle& triangle : mesh.triangles) {
    for (const std::uint32_t vertex : triangle) ids[vertex] = 1;
  }
  std::uint32_t n = 0;
  for (std::uint32_t vertex = 0; vertex < ids.size(); ++vertex) {
    if (ids[vertex] == 0) continue;
    mesh.positions[n] = mesh.positions[vertex];
    if (!mesh.normals.empty()) mesh.normals[n] = mesh.normals[vertex];
    if (!mesh.colors.empty()) mesh.colors[n] = mesh.colors[vertex];
    ids[vertex] = n++;
  }
  mesh.positions.resize(n);
  if (!mesh.normals.empty()) mesh.normals.resize(n);
  if (!mesh.colors.empty()) mesh.colors.resize(n);
  for (Triangle& triangle : mesh.triangles) {
    for (std::uint32_t& vertex : triangle) vertex = ids[vertex];
  }
}

/// Removes pairs of triangles with the same vertices and opposite orientations, and vertices without triangles.
void remove_folds(TriangleMesh& mesh) {
  const auto from_smallest = [](Triangle triangle) {
    std::rotate(triangle.begin(), std::min_element(triangle.begin(), triangle.end()), triangle.end());
    return triangle;
  };
  std::vector<Triangle> all(mesh.triangles.size());
  std::transform(mesh.triangles.begin(), mesh.triangles.end(), all.begin(), from_smallest);
  std::sort(all.begin(), all.end());
  keep_triangles(mesh, [&](const Triangle& t) {
    return !std::binary_search(all.begin(), all.end(), from_smallest({t[0], t[2], t[1]}));
  });
}

/// Calls pair(forward, backward) for pairs of triangles at an edge, given by their corners. From a triangle whose edge
/// goes from `low` to `high`, its partner is the first one in the other direction when turning about the edge towards
/// the inside. If n triangles have the edge, up to n / 2 pairs are found.
template <class Pair>
void pair_by_angle(const TriangleMesh& mesh, const Edge* edges, std::size_t n, const Pair& pair) {
  struct Side {
    double angle;
    std::uint32_t corner;
    bool is_forward, is_paired;
  };
  const Vec start = mesh.position(edges[0].low);
  const Vec along = mesh.position(edges[0].high) - start;
  const auto across = [&](std::uint32_t corner) {  // from the edge to the third corner
    const Vec to = mesh.position(vertex_at(mesh, next_corner(next_corner(corner)))) - start;
    return to - (dot(to, along) / std::max(dot(along, along), 1e-300)) * along;
  };
  const Vec first = across(edges[0].corner), other = cross(along, first);
  const double scale = std::sqrt(dot(along, along));  // `other` is longer than `first` by this factor
  std::vector<Side> sides;
  for (std::size_t i = 0; i < n; ++i) {
    const Vec to = across(edges[i].corner);
    sides.push_back({std::atan2(dot(to, other), scale * dot(to, first)), edges[i].corner,
                     vertex_at(mesh, edges[i].corner) == edges[i].low, false});
  }
  std::sort(sides.begin(), sides.end(),
            [](const Side& a, const Side& b) { return a.angle != b.angle ? a.angle < b.angle : a.corner < b.corner; });
  for (std::size_t i = 0; i < n; ++i) {
    if (!sides[i].is_forward) continue;
    for (std::size_t step = 1; step < n; ++step) {
      Side& partner = sides[(i + n - step) % n];
      if (partner.is_forward || partner.is_paired) continue;
      partner.is_paired = true;
      pair(sides[i].corner, partner.corner);
      break;
    }
  }
}

bool is_manifold(const TriangleMesh& mesh, const Edge* edges, std::size_t n) {
  return n == 1 || (n == 2 && vertex_at(mesh, edges[0].corner) != vertex_at(mesh, edges[1].corner));
}

/// Adds a vertex with the position `at` and the other values of `like`. Returns its index.
std::uint32_t add_vertex(TriangleMesh& mesh, const Vec3f& at, std::uint32_t like) {
  mesh.positions.push_back(at);
  if (!mesh.normals.empty()) mesh.normals.push_back(Vec3f(mesh.normals[like]));
  if (!mesh.colors.empty()) mesh.colors.push_back(TriangleMesh::Color(mesh.colors[like]));
  return static_cast<std::uint32_t>(mesh.positions.size() - 1);
}

/// Where an edge has several pairs of triangles, gives all pairs but the first a vertex of their own at its midpoint.
/// Only edges whose two ends each connect all their triangles in another way need this.
void split_edges(TriangleMesh& mesh) {
  constexpr std::uint32_t kNone = ~0u;
  const std::size_t n_triangles = mesh.triangles.size();
  std::vector<std::uint32_t> midpoints(3 * n_triangles, kNone);  // of the edges from a corner to the next
  for_edges(mesh, [&](const Edge* edges, std::size_t n) {
    if (is_manifold(mesh, edges, n)) return;
    bool keeps_edge = true;  // the first pair does
    std::set<std::uint32_t> unpaired;
    for (std::size_t i = 0; i < n; ++i) unpaired.insert(edges[i].corner);
    const auto separate = [&](std::uint32_t a, std::uint32_t b) {
      unpaired.erase(a);
      unpaired.erase(b);
      if (std::exchange(keeps_edge, false)) return;
      const Vec3f middle = 0.5f * (mesh.positions[edges[0].low] + mesh.positions[edges[0].high]);
      midpoints[a] = midpoints[b] = add_vertex(mesh, middle, edges[0].low);
    };
    pair_by_angle(mesh, edges, n, separate);
    while (!unpaired.empty()) separate(*unpaired.begin(), *unpaired.begin());
  });
  for (std::size_t t = 0; t < n_triangles; ++t) {
    const Triangle triangle = mesh.triangles[t];
    const std::uint32_t* const own = &midpoints[3 * t];
    const auto first = static_cast<std::size_t>(std::find_if(own, own + 3, [&](auto m) { return m != kNone; }) - own);
    if (first == 3) continue;
    std::vector<std::uint32_t> polygon;  // from the first midpoint on
    for (std::size_t k = first; k < first + 3; ++k) {
      if (own[k % 3] != kNone) polygon.push_back(own[k % 3]);
      polygon.push_back(triangle[(k + 1) % 3]);
    }
    mesh.triangles[t] = {polygon[0], polygon[1], polygon[2]};
    for (std::size_t k = 3; k < polygon.size(); ++k) mesh.triangles.push_back({polygon[0], polygon[k - 1], polygon[k]});
  }
}

}  // namespace

Topology count_edges(const TriangleMesh& mesh) {
  Topology topology;
  for_edges(mesh, [&](const Edge* edges, std::size_t n) {
    if (n == 1) ++topology.boundary_edges;
    if (!is_manifold(mesh, edges, n)) ++topology.non_manifold_edges;
  });
  return topology;
}

Components remove_small_components(TriangleMesh& mesh, double share) {
  Sets sets(mesh.positions.size());
  for (const Triangle& t : mesh.triangles) {
    sets.join(t[0], t[1]);
    sets.join(t[0], t[2]);
  }
  std::vector<double> areas(mesh.positions.size());
  for (const Triangle& triangle : mesh.triangles) {
    const Vec normal = mesh.area_normal(triangle);
    areas[sets.find(triangle[0])] += std::sqrt(dot(normal, normal));
  }
  const double least = areas.empty() ? 0 : share * *std::max_element(areas.begin(), areas.end());
  Components components;
  for (const double area : areas) {
    if (area > 0) ++(area < least ? components.removed : components.kept);
  }
  keep_triangles(mesh, [&](const Triangle& triangle) { return areas[sets.find(triangle[0])] >= least; });
  return components;
}

void crop(TriangleMesh& mesh, const std::function<bool(const std::array<double, 3>&)>& contains) {
  std::vector<char> is_inside(mesh.positions.size());
  for (std::size_t i = 0; i < is_inside.size(); ++i) {
    is_inside[i] = contains({mesh.positions[i].x, mesh.positions[i].y, mesh.positions[i].z});
  }
  keep_triangles(mesh, [&](const Triangle& t) { return is_inside[t[0]] && is_inside[t[1]] && is_inside[t[2]]; });
}

std::size_t split_non_manifold(TriangleMesh& mesh) {
  Sets corners(3 * mesh.triangles.size());
  const auto pair = [&](std::uint32_t a, std::uint32_t b) {  // edges of opposite directions
    corners.join(a, next_corner(b));
    corners.join(next_corner(a), b);
  };
  for_edges(mesh, [&](const Edge* edges, std::size_t n) {
    if (n > 2) return pair_by_angle(mesh, edges, n, pair);
    if (n == 2 && is_manifold(mesh, edges, n)) pair(edges[0].corner, edges[1].corner);
  });
  // Each vertex belongs to the first set of corners at it. Other sets get copies.
  constexpr std::uint32_t kNone = ~0u;
  const std::size_t n_before = mesh.positions.size();
  std::vector<std::uint32_t> owners(n_before, kNone), ids(3 * mesh.triangles.size(), kNone);
  for (std::uint32_t corner = 0; corner < ids.size(); ++corner) {
    std::uint32_t& vertex = mesh.triangles[corner / 3][corner % 3];
    std::uint32_t& id = ids[corners.find(corner)];
    if (id == kNone && owners[vertex] == kNone) {
      owners[vertex] = corner;
      id = vertex;
    } else if (id == kNone) {
      id = add_vertex(mesh, Vec3f(mesh.positions[vertex]), vertex);
    }
    vertex = id;
  }
  split_edges(mesh);
  return mesh.positions.size() - n_before;
}

double decimate(TriangleMesh& mesh, std::size_t n_triangles) {
  if (n_triangles >= mesh.triangles.size()) return 0;
  std::vector<Triangle> result(mesh.triangles.size());
  const float* const positions = &mesh.positions[0].x;
  float error = 0;
  const std::size_t n =
      meshopt_simplify(result[0].data(), mesh.triangles[0].data(), 3 * mesh.triangles.size(), positions,
                       mesh.positions.size(), sizeof(Vec3f), 3 * n_triangles, 1.0f, /*options=*/0, &error);
  const double scale = meshopt_simplifyScale(positions, mesh.positions.size(), sizeof(Vec3f));
  result.resize(n / 3);
  mesh.triangles.swap(result);
  remove_folds(mesh);
  return scale * error;
}

void set_normals(TriangleMesh& mesh) {
  std::vector<Vec> sums(mesh.positions.size());
  for (const Triangle& triangle : mesh.triangles) {
    const Vec normal = mesh.area_normal(triangle);
    for (const std::uint32_t vertex : triangle) sums[vertex] = sums[vertex] + normal;
  }
  mesh.normals.resize(sums.size());
  for (std::size_t i = 0; i < sums.size(); ++i) {
    const double length = std::sqrt(dot(sums[i], sums[i]));
    const Vec unit = length > 0 ? (1 / length) * sums[i] : Vec{0, 0, 1};
    mesh.normals[i] = {static_cast<float>(unit.x), static_cast<float>(unit.y), static_cast<float>(unit.z)};
  }
}

}  // namespace b3dgs
