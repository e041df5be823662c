// Depth images of the surface, one per view, from which a mesh is fused.
#pragma once

#include <cstdint>
#include <vector>

#include "core/vec.h"
#include "scene/cameras/camera.h"

namespace b3dgs {

/// Depth images store the cosine of the angle between ray and normal in 8 bits. Where it is less than that of 80
/// degrees, the depth is not used, because a small error of the direction is a large one of the depth.
inline constexpr int kCosineLevels = 255;
inline constexpr int kLeastCosine = 44;

struct DepthView {
  Camera camera;
  std::vector<float> depth;          // [height, width], as lens_depth() in raster/math/lens.h; 0: no surface
  std::vector<std::uint8_t> cosine;  // [height, width], times kCosineLevels

  std::size_t index(int x, int y) const { return static_cast<std::size_t>(y) * camera.width + x; }
};

/// Returns the directions of the light at all pixels, [height, width], in camera coordinates and with depth 1. They are
/// 0 where the lens shows none.
std::vector<Vec3f> pixel_rays(const Camera& camera);

/// Makes a view from a depth image and one of unit normals in camera coordinates ([height, width, 3]). Depths beyond
/// `far`, and those seen at a grazing angle, become 0.
DepthView make_depth_view(const Camera& camera, std::vector<float> depth, const float* normals, double far);

/// Keeps a depth if at least `n_agree` of the six nearest views have the same surface within 1 %. Returns the share of
/// depths that stay. Does nothing if n_agree is 0.
double keep_consistent(std::vector<DepthView>& views, int n_agree = 2);

/// Returns the median over all views of the size of a pixel at the surface, or 0 if there is no surface.
double median_pixel_size(const std::vector<DepthView>& views);

}  // namespace b3dgs
