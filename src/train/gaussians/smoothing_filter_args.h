// Size of the 3D smoothing filter (raster/math/antialiasing.h), from the finest detail of each Gaussian that any
// training photograph can show (Mip-Splatting, Yu et al. 2024, section 5.1). The same arithmetic on CPU and GPU.
#pragma once

#include <cmath>
#include <cstdint>

#include "raster/args.h"
#include "raster/math/array_rows.h"
#include "raster/math/projection.h"

namespace b3dgs {

/// The part of a training view that the filter needs.
struct FilterView {
  ViewTransform<float> transform{};
  float width = 0, height = 0;  // px
};

/// All arrays are on one device.
struct SmoothingFilterArgs {
  const float* means = nullptr;  // [N, 3] world
  std::int32_t n_views = 0;
  const FilterView* views = nullptr;
  float near_plane = kNearPlane;   // world units
  float* filters = nullptr;        // [N] out, world units
  const float* largest = nullptr;  // [1] of finest pixels
};

// A view contains a Gaussian if the mean is beyond the near plane and projects into the image, extended by this
// fraction of its size on each side, since a Gaussian centred outside the image may still be visible.
inline constexpr float kFilterMargin = 0.15f;
// The filter's variance, as a fraction of the square of the finest pixel size.
inline constexpr float kFilterVariance = 0.2f;

/// Writes the smallest size of a pixel at Gaussian i's depth, over the views that contain it, world units; 0 if none
/// does.
B3DGS_HD void write_finest_pixel(const SmoothingFilterArgs& args, std::int64_t i) {
  const Vec3f mean = load3(args.means, i);
  float finest = 0;
  for (std::int32_t v = 0; v < args.n_views; ++v) {
    const FilterView& view = args.views[v];
    const Vec3f point = to_camera(view.transform, mean);
    if (!(point.z > args.near_plane)) continue;
    const float x = view.transform.fx * point.x / point.z + view.transform.cx;
    const float y = view.transform.fy * point.y / point.z + view.transform.cy;
    const bool is_inside = x >= -kFilterMargin * view.width && x <= (1 + kFilterMargin) * view.width &&
                           y >= -kFilterMargin * view.height && y <= (1 + kFilterMargin) * view.height;
    if (!is_inside) continue;
    const float pixel = point.z / (view.transform.fx > view.transform.fy ? view.transform.fx : view.transform.fy);
    if (finest == 0 || pixel < finest) finest = pixel;
  }
  args.filters[i] = finest;
}

/// Turns the finest pixel into the filter. Where no view contains the Gaussian, the largest of all takes its place.
B3DGS_HD void write_filter_size(const SmoothingFilterArgs& args, std::int64_t i) {
  const float finest = args.filters[i], largest = *args.largest;
  args.filters[i] = std::sqrt(kFilterVariance) * (finest > 0 ? finest : largest);
}

}  // namespace b3dgs
