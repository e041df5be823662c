// Colours of the vertices of a mesh, from photographs.
#pragma once

#include <cstddef>
#include <functional>
#include <vector>

#include "app/mesh/depth_views.h"
#include "model/formats/triangle_mesh.h"
#include "scene/images/image.h"

namespace b3dgs {

/// Returns the photograph of a view (RGB), of any size with the same aspect ratio.
using PhotographOf = std::function<Image8(std::size_t view)>;

/// Sets the colour of each vertex to the mean of the photographs that see it, weighted by (cosine / depth)^2. A view
/// sees a vertex if its depth there differs by at most `tolerance`. A vertex that no view sees takes the colours of its
/// neighbours. The mesh must have normals. Returns the share of vertices that photographs show.
double color_vertices(TriangleMesh& mesh, const std::vector<DepthView>& views, const PhotographOf& photograph,
                      double tolerance);

}  // namespace b3dgs
