// Nearest points and rays on a triangle mesh (Embree).
#pragma once

#include <cstdint>
#include <memory>
#include <optional>

#include "model/formats/triangle_mesh.h"

namespace b3dgs {

class TriangleScene {
 public:
  /// Keeps a reference to the mesh.
  explicit TriangleScene(const TriangleMesh& mesh);
  ~TriangleScene();
  TriangleScene(const TriangleScene&) = delete;
  TriangleScene& operator=(const TriangleScene&) = delete;

  struct Nearest {
    double distance = 0;
    std::uint32_t triangle = 0;
  };
  /// Returns the nearest triangle. The mesh must have one.
  Nearest nearest(const Vec3<double>& point) const;

  struct Hit {
    float t = 0;  // origin + t * direction is on the triangle
    std::uint32_t triangle = 0;
  };
  /// Returns the first triangle that a ray meets at t in (0, limit), seen from either side.
  std::optional<Hit> first_hit(const Vec3f& origin, const Vec3f& direction, float limit) const;

 private:
  struct Embree;
  const TriangleMesh& mesh_;
  std::unique_ptr<Embree> embree_;
};

/// Returns the distance of a point from the triangle with corners a, b and c.
double distance_from_triangle(const Vec3<double>& point, const Vec3<double>& a, const Vec3<double>& b,
                              const Vec3<double>& c);

}  // namespace b3dgs
