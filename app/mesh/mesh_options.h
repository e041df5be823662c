// The options of b3dgs mesh.
#pragma once

#include <cstdint>
#include <string>

#include "core/config.h"
#include "raster/geometry.h"

namespace b3dgs {

struct MeshOptions {
  std::string output;
  bool overwrite = false;
  double voxel = 0;
  double trunc = 4;
  int views = 0;
  DepthKind depth_kind = DepthKind::kSurface;
  int consistent = 2;
  double far = 0;
  double min_component = 0.01;
  std::int64_t faces = 0;
  std::string crop;
  bool colors = true;
  double memory_gb = 0;
  std::string compare;
  double threshold = 0;
  std::string json;
};

template <class Visitor>
void visit_fields(MeshOptions& c, Visitor&& field) {
  field(Option{"output"}, c.output, Any{}, "file to write: .ply, .obj or .glb");
  field(Option{"overwrite"}, c.overwrite, Any{}, "replace the file if it exists");
  field(Option{"voxel"}, c.voxel, AtLeast{0}, "side of a voxel, world units (0 = 1.5 x a pixel at the surface)");
  field(Option{"trunc"}, c.trunc, InRange{2, 10}, "truncation of distances from the surface, voxels");
  field(Option{"views"}, c.views, AtLeast{0}, "training views to fuse, evenly spaced (0 = all)");
  field(Option{"depth_kind"}, c.depth_kind, one_of<DepthKind>(), "depth of a pixel, as in b3dgs render");
  field(Option{"consistent"}, c.consistent, InRange{0, 6},
        "keep a depth if N of the 6 nearest views have it within 1 % (0 = all depths)");
  field(Option{"far"}, c.far, AtLeast{0},
        "leave out surfaces beyond this depth, world units (0 = 3 x the median depth of the views)");
  field(Option{"min_component"}, c.min_component, InRange{0, 1},
        "remove components with less than this share of the largest one's area");
  field(Option{"faces"}, c.faces, AtLeast{0}, "reduce the mesh to about N triangles (0 = all)");
  field(Option{"crop"}, c.crop, Any{}, "keep what is in a box X0,Y0,Z0,X1,Y1,Z1 or a sphere X,Y,Z,RADIUS");
  field(Option{"colors"}, c.colors, Any{}, "colour vertices from the photographs");
  field(Option{"memory_gb"}, c.memory_gb, AtLeast{0},
        "memory for fusing, GB (0 = half of what is free); it does not change the result");
  field(Option{"compare"}, c.compare, Any{}, "true surface, a PLY with faces, from which to measure distances");
  field(Option{"threshold"}, c.threshold, AtLeast{0}, "distance for the F-score, world units (0 = 2 voxels)");
  field(Option{"json"}, c.json, Any{}, "write the figures to this file");
}

}  // namespace b3dgs
