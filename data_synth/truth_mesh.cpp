#include "data_synth/truth_mesh.h"

#include <cmath>
#include <cstdint>

namespace b3dgs {
namespace {

using Vec = Vec3<double>;

/// Appends a grid of n_u x n_v quads over a surface that is closed along u. at(u, v) is defined on [0, 2 pi) x [0, 1],
/// and the outside is where the cross product of its derivatives points. Triangles without area, as at poles, are left
/// out.
template <class At>
void append_surface(std::uint32_t n_u, std::uint32_t n_v, const At& at, TriangleMesh& mesh) {
  const auto first = static_cast<std::uint32_t>(mesh.positions.size());
  for (std::uint32_t j = 0; j <= n_v; ++j) {
    for (std::uint32_t i = 0; i < n_u; ++i) {
      const Vec p = at(2 * kPi * i / n_u, static_cast<double>(j) / n_v);
      mesh.positions.push_back({static_cast<float>(p.x), static_cast<float>(p.y), static_cast<float>(p.z)});
    }
  }
  const auto add = [&](std::uint32_t a, std::uint32_t b, std::uint32_t c) {
    const Vec normal = mesh.area_normal({a, b, c});
    if (dot(normal, normal) > 1e-24) mesh.triangles.push_back({a, b, c});
  };
  for (std::uint32_t j = 0; j < n_v; ++j) {
    for (std::uint32_t i = 0; i < n_u; ++i) {
      const std::uint32_t row = first + j * n_u, next = (i + 1) % n_u;
      add(row + i, row + next, row + n_u + next);
      add(row + i, row + n_u + next, row + n_u + i);
    }
  }
}

/// Returns the unit vector at an angle in the plane of the ground.
Vec around(double angle) {
  return {std::cos(angle), std::sin(angle), 0};
}

}  // namespace

void append_disc(const Vec& center, double radius, TriangleMesh& mesh) {
  append_surface(
      512, 1, [&](double u, double v) { return center + ((1 - v) * radius) * around(u); }, mesh);
}

void append_ball(const Vec& center, double radius, TriangleMesh& mesh) {
  const auto at = [&](double u, double v) {
    const double latitude = (v - 0.5) * kPi;
    return center + radius * (std::cos(latitude) * around(u) + Vec{0, 0, std::sin(latitude)});
  };
  append_surface(256, 128, at, mesh);
}

void append_box(const Vec& center, const Vec& half, bool has_bottom, TriangleMesh& mesh) {
  const double halves[3] = {half.x, half.y, half.z}, centers[3] = {center.x, center.y, center.z};
  for (int face = 0; face < (has_bottom ? 6 : 5); ++face) {
    const int axis = face / 2;
    const double side = face % 2 == 0 ? 1 : -1;
    const auto first = static_cast<std::uint32_t>(mesh.positions.size());
    for (const auto& [u, v] : {Vec2<double>{-1, -1}, {1, -1}, {1, 1}, {-1, 1}}) {
      double p[3];
      p[axis] = centers[axis] + side * halves[axis];
      p[(axis + 1) % 3] = centers[(axis + 1) % 3] + side * u * halves[(axis + 1) % 3];
      p[(axis + 2) % 3] = centers[(axis + 2) % 3] + v * halves[(axis + 2) % 3];
      mesh.positions.push_back({static_cast<float>(p[0]), static_cast<float>(p[1]), static_cast<float>(p[2])});
    }
    mesh.triangles.push_back({first, first + 1, first + 2});
    mesh.triangles.push_back({first, first + 2, first + 3});
  }
}

void append_ring(const Vec& center, double major, double minor, TriangleMesh& mesh) {
  const auto at = [&](double u, double v) {
    const double angle = 2 * kPi * v;
    return center + (major + minor * std::cos(angle)) * around(u) + Vec{0, 0, minor * std::sin(angle)};
  };
  append_surface(256, 128, at, mesh);
}

TriangleMesh orbit_truth_mesh() {
  TriangleMesh mesh;
  append_disc({0, 0, 0}, kGroundRadius, mesh);
  append_ball(kBallCenter, kBallRadius, mesh);
  append_box(kBoxCenter, {kBoxHalf, kBoxHalf, kBoxHalf}, false, mesh);
  append_ring(kRingCenter, kRingMajor, kRingMinor, mesh);
  return mesh;
}

}  // namespace b3dgs
