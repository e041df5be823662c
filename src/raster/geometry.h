// Depth and normals of the surface that a view shows, which the geometry pass computes from the lists of the last
// forward pass. Arrays are as in args.h.
#pragma once

#include <array>

#include "raster/args.h"

namespace b3dgs {

/// Which splats determine the depth of a pixel. `T` is the transmittance along the ray.
enum class DepthKind {
  kSurface,  // those that T falls from 0.6 to 0.4 in, weighted by how far it falls in each
  kMedian,   // the one in which T falls below 0.5
  kMean,     // all, by their blend weights; depths of centres instead of planes
};
constexpr std::array<const char*, 3> names_of(DepthKind) {
  return {"surface", "median", "mean"};
}

/// Geometry of a view. Where the transmittance stays at 0.5 or above there is no surface, and all values are 0.
struct GeometryArrays {
  float* depth = nullptr;   // [H, W] world units, measured like Splat::depth
  float* normal = nullptr;  // [H, W, 3] unit vector of the camera frame, towards the camera
  // [H, W] in (0, 1], how well the splats of DepthKind agree: 1 / (1 + (s / kConfidentSpread)^2), where s is the
  // standard deviation of depth divided by depth. Each splat also has its own thickness along the ray.
  float* confidence = nullptr;
};
inline constexpr float kConfidentSpread = 0.01f;

/// A splat as the geometry pass sees it (math/plane.h). At a pixel, its value is value + slope . (pixel - mean).
struct alignas(16) PlaneRow {
  float value;             // at the mean: 1 / depth (1/world unit), or the depth (DepthKind::kMean)
  float slope_x, slope_y;  // change per px; 0 for DepthKind::kMean
  float variance;          // of depth along the ray divided by the square of depth, from thickness; at most 1
  Vec3f normal;            // unit vector of the camera frame, towards the camera
  float unused;
};
static_assert(sizeof(PlaneRow) == 32, "two 16-byte loads");

/// Arguments of the planes of a view's splats.
struct PlaneArgs {
  GaussianArrays gaussians{};
  CameraView view{};
  bool antialiasing = false;
  DepthKind kind = DepthKind::kSurface;
};

/// Geometry pass. Like scoring, it repeats the blend entry by entry in list order, so the result does not depend on the
/// forward kernel.
struct GeometryArgs : TileLists {
  const PlaneRow* planes = nullptr;  // [M]
  DepthKind kind = DepthKind::kSurface;
  GeometryArrays out{};
};

}  // namespace b3dgs
