// Removes, splits and simplifies parts of a triangle mesh. Vertices that no triangle uses are removed, and the order of
// the others stays.
#pragma once

#include <array>
#include <cstddef>
#include <functional>

#include "model/formats/triangle_mesh.h"

namespace b3dgs {

struct Topology {
  std::size_t boundary_edges = 0;      // with one triangle
  std::size_t non_manifold_edges = 0;  // with more than two triangles, or two of opposite orientation
};
Topology count_edges(const TriangleMesh& mesh);

struct Components {
  std::size_t kept = 0, removed = 0;
};
/// Removes connected components whose area is less than `share` of the largest one's.
Components remove_small_components(TriangleMesh& mesh, double share);

/// Keeps the triangles whose corners are all inside.
void crop(TriangleMesh& mesh, const std::function<bool(const std::array<double, 3>& position)>& contains);

/// Gives triangles that only meet at a vertex, or at an edge with others, vertices of their own, so that no edge is
/// non-manifold. Of the triangles at an edge, pairs that bound the same solid stay connected. If the ends of such an
/// edge cannot be separated, a pair gets a vertex at its midpoint. Returns the number of added vertices.
std::size_t split_non_manifold(TriangleMesh& mesh);

/// Collapses edges until about `n_triangles` are left, or more if others would change how the surface is connected
/// (meshoptimizer). Borders keep their shape but not all their vertices, since a ragged border can have most of them.
/// Removes what has become flat, a pair of triangles with the same vertices. Returns the estimated distance between
/// both surfaces.
double decimate(TriangleMesh& mesh, std::size_t n_triangles);

/// Sets the normals of vertices to the mean of their triangles', weighted by area.
void set_normals(TriangleMesh& mesh);

}  // namespace b3dgs
