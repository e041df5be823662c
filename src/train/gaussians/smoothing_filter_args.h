// Size of the 3D smoothing filter (raster/math/antialiasing.h), from the finest detail of each Gaussian that any
// training photograph can show (Mip-Splatting, Yu et al. 2024, section 5.1). CPU and GPU use the same arithmetic.
#pragma once

#include <cmath>
#include <cstdint>

#include "raster/args.h"
#include "raster/math/array_rows.h"
#include "raster/math/projection.h"

namespace b3dgs {

/// Data of a training view for the filter.
struct FilterView {
  ViewTransform<float> transform{};
  float width = 0, height = 0;  // px
};

/// Arguments of write_finest_pixel() and write_filter_size(). All arrays are on one device.
struct SmoothingFilterArgs {
  const float* means = nullptr;  // [N, 3] world
  std::int32_t n_views = 0;
  const FilterView* views = nullptr;
  float near_plane = kNearPlane;   // world units
  float* filters = nullptr;        // [N] out, world units
  const float* largest = nullptr;  // [1] largest of the finest pixels
};

// A view contains a Gaussian if the mean is beyond the near plane and projects into the image, extended by this
// fraction of its size on each side, because a Gaussian centred outside the image may still be visible.
inline constexpr float kFilterMargin = 0.15f;
// Variance of the filter as a fraction of the squared finest pixel size.
inline constexpr float kFilterVariance = 0.2f;

/// Writes the smallest size of a pixel at the depth of Gaussian i over the views that contain it, in world units, or 0
/// if none does.
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

/// Converts the finest pixel to the filter. If no view contains the Gaussian, the largest of all finest pixels is used
/// instead.
B3DGS_HD void write_filter_size(const SmoothingFilterArgs& args, std::int64_t i) {
  const float finest = args.filters[i], largest = *args.largest;
  args.filters[i] = std::sqrt(kFilterVariance) * (finest > 0 ? finest : largest);
}

}  // namespace b3dgs
