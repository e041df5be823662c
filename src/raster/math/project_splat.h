// Projects one Gaussian to the splat of one view, without its colour. Here CPU and GPU decide whether a Gaussian is
// culled, invalid or visible. Both projection passes are loops around project_splat().
#pragma once

#include <cmath>
#include <cstdint>
#include <type_traits>

#include "raster/args.h"
#include "raster/math/antialiasing.h"
#include "raster/math/array_rows.h"
#include "raster/math/opacity.h"
#include "raster/math/projection.h"
#include "raster/math/tiling.h"

namespace b3dgs {

namespace detail {

B3DGS_HD bool is_finite(float value) {
#if defined(__CUDA_ARCH__)
  return ::isfinite(value);
#else
  return std::isfinite(value);
#endif
}

}  // namespace detail

enum class Outcome {
  kSeen,     // visible: the splat touches at least one tile; it has a radius, and density control counts the view
  kCulled,   // nearer than the near plane, outside the image, or (kEllipse) with an opacity below 1/255
  kInvalid,  // a parameter or the projection is not finite or exceeds a limit in constants.h
};

/// Text after "Gaussian 12" in the error for kInvalid.
inline constexpr const char* kInvalidText =
    " is invalid: its projection or colour is not finite, or it is larger than 1e9 px, farther than 1e12 units or "
    "brighter than 1e9";

struct ProjectedGaussian {
  Outcome outcome = Outcome::kCulled;
  // Set if the Gaussian is visible:
  std::int32_t radius = 0;  // 3 standard deviations in px, rounded up
  Vec2f extent{};           // half width and height (px) of the box around alpha >= 1/255
  Splat splat{};            // red, green, blue and clamped are 0
};

/// Projects Gaussian i. `lens`: Pinhole or ViewLens.
template <bool kAntialiasing, class Lens>
B3DGS_HD ProjectedGaussian project_splat(const GaussianArrays& gaussians, std::int64_t i,
                                         const ViewTransform<float>& view, const Lens& lens, float near_plane,
                                         Culling culling, const TileGrid& grid) {
  const Vec3f point = to_camera(view, load3(gaussians.means, i));
  const float depth = lens_depth(lens, point);
  if (!detail::is_finite(point.x + point.y + point.z) || depth > kDepthMax) return {Outcome::kInvalid};
  if (depth < near_plane) return {Outcome::kCulled};

  const Vec3f log_scales = load3(gaussians.log_scales, i);
  const Vec4f quat = load4(gaussians.quats, i);
  const float logit = gaussians.logit_opacities[i];
  if (!detail::is_finite(logit + log_scales.x + log_scales.y + log_scales.z + quat.x + quat.y + quat.z + quat.w)) {
    return {Outcome::kInvalid};
  }
  float log2_opacity = log2_sigmoid(logit);
  if (culling == Culling::kEllipse && log2_opacity < kLog2AlphaMin) return {Outcome::kCulled};

  const Smoothed<float> smoothed = smooth_if<kAntialiasing>(gaussians.filters, i, log_scales);
  const Shape<float> shape = make_shape(smoothed.log_scales, quat);
  if constexpr (!std::is_same_v<Lens, Pinhole>) {
    if (is_out_of_lens(lens, point)) return {Outcome::kCulled};
  }
  const Projection<float> p = project_gaussian(view, lens, point, shape.factor);
  if constexpr (!std::is_same_v<Lens, Pinhole>) {
    if (!(p.shrink > 0)) return {Outcome::kInvalid};  // so large that its square is not finite
  }
  if constexpr (kAntialiasing) {
    log2_opacity += kLog2e * (smoothed.log_opacity_ratio + std::log(blur_ratio(p)) / 2);
    if (culling == Culling::kEllipse && log2_opacity < kLog2AlphaMin) return {Outcome::kCulled};
  }
  const float radius = std::ceil(kSquareSigmas * largest_sigma(p.cov));
  if (!detail::is_finite(p.mean2d.x + p.mean2d.y + p.conic.xx + p.conic.xy + p.conic.yy + log2_opacity) ||
      !(radius <= kRadiusMax) || !(shape.inverse_length <= kInverseQuatLengthMax)) {
    return {Outcome::kInvalid};
  }
  ProjectedGaussian result;
  result.radius = static_cast<std::int32_t>(radius);
  result.extent = ellipse_extent(log2_opacity, p.cov);
  result.splat = {p.mean2d.x,
                  p.mean2d.y,
                  log2_opacity,
                  depth,
                  kConicScale * p.conic.xx,
                  kConicScale * p.conic.xy,
                  kConicScale * p.conic.yy,
                  static_cast<std::int32_t>(i),
                  0,
                  0,
                  0,
                  0};
  if (touches_tiles(grid, culling, result.splat, result.extent, result.radius)) result.outcome = Outcome::kSeen;
  return result;
}

// The seam of a panorama. A splat that crosses it is drawn twice, a full turn apart, and each copy has its own sums.
// Before the backward projection, the sums of the second are added to those of the first.

/// Returns the second splat of a visible Gaussian, culled if there is none. `turn` is the width of a full turn in px,
/// which is the width of the image unless that was reduced.
B3DGS_HD ProjectedGaussian across_the_seam(const ProjectedGaussian& first, float turn, Culling culling,
                                           const TileGrid& grid) {
  ProjectedGaussian second = first;
  const bool is_left = first.splat.mean_x < static_cast<float>(grid.image_width) / 2;
  second.splat.mean_x = (StrictFloat(first.splat.mean_x) + (is_left ? turn : -turn)).value;
  const bool is_seen = touches_tiles(grid, culling, second.splat, second.extent, second.radius);
  second.outcome = is_seen ? Outcome::kSeen : Outcome::kCulled;
  return second;
}

// Inverse depth, the sum of weight over depth (RenderSettings::inverse_depth). Binning orders splats by their depth.
// Then the depth of each splat is replaced by its inverse, which the blend sums like a depth, and the backward blend
// gives the gradient with respect to the inverse. So every kernel renders inverse depth without code for it.

B3DGS_HD void invert_depth(Splat& splat) {
  splat.depth = 1.0f / splat.depth;
}

/// Returns the gradient of a splat's depth from that of its inverse. `splat.depth` is already inverted.
B3DGS_HD float depth_gradient(const Splat& splat, float grad_inverse) {
  return -(splat.depth * splat.depth) * grad_inverse;
}

}  // namespace b3dgs
