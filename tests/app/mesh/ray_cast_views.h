// Scenes of solids with their exact depth images, and with the errors that rendered ones have.
#pragma once

#include <vector>

#include "app/mesh/depth_views.h"
#include "model/formats/triangle_mesh.h"

namespace b3dgs::test {

/// A surface and cameras around it.
struct SolidScene {
  TriangleMesh surface;
  std::vector<Camera> cameras;
};

/// Makes a ball and a box with cameras on all sides. Images have the ratio 4:3.
SolidScene closed_scene(int width);

/// Makes a ball and a box above a disc, with cameras above it.
SolidScene open_scene(int width);

struct DepthErrors {
  double noise = 0;  // standard deviation relative to the depth; half white, half smooth over 8 px
  double tilt = 0;   // standard deviation of each component of the unit normal
  int floaters = 0;  // discs of wrong depth in each view
};
inline constexpr DepthErrors kUsualErrors{0.002, 0.1, 6};

/// Returns the depths and normals of the surface in each view, for any lens.
std::vector<DepthView> ray_cast_views(const SolidScene& scene, const DepthErrors& errors = {});

}  // namespace b3dgs::test
