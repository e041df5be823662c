// How far a mesh is from the true surface.
#pragma once

#include <cstdint>
#include <vector>

#include "model/formats/triangle_mesh.h"
#include "scene/cameras/camera.h"

namespace b3dgs {

/// Distances of points that are spread evenly over one surface from another one.
struct SurfaceDistance {
  std::int64_t n_points = 0;
  double mean = 0, p95 = 0;
  double share = 0, share_of_half = 0;  // of the points that are within the threshold, or half of it
  double degrees = 0;                   // mean angle between the normals of both surfaces
};

struct MeshQuality {
  SurfaceDistance accuracy;      // from the mesh, as far as it is in the box of the truth, to the truth
  SurfaceDistance completeness;  // from the part of the truth that cameras see to the mesh

  double chamfer() const { return 0.5 * (accuracy.mean + completeness.mean); }
  double f_score() const { return harmonic(accuracy.share, completeness.share); }
  double f_score_of_half() const { return harmonic(accuracy.share_of_half, completeness.share_of_half); }

 private:
  static double harmonic(double a, double b) { return a + b > 0 ? 2 * a * b / (a + b) : 0; }
};

/// Compares a mesh with the truth. A point of the truth counts if at least two cameras see it within 80 degrees of its
/// normal and nothing is in front of it. Without cameras, all of it counts. Both meshes must have triangles. n_points
/// is the number of points on each surface before some of them are left out. `threshold` is in world units.
MeshQuality compare_meshes(const TriangleMesh& mesh, const TriangleMesh& truth, const std::vector<Camera>& cameras,
                           double threshold, std::int64_t n_points = 1000000);

}  // namespace b3dgs
