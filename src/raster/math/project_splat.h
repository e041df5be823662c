// Projects one Gaussian to the splat of one view, except for its colour. This is where CPU and GPU decide whether a
// Gaussian is culled, invalid or seen; both projection passes are loops around project_splat().
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
  kSeen,     // the splat touches at least one tile: it has a radius, and density control counts the view
  kCulled,   // nearer than the near plane, outside the image, or (kEllipse) of an opacity below 1/255
  kInvalid,  // a parameter or the projection is not finite or exceeds a limit in constants.h
};

/// Text that follows "Gaussian 12" in the error for kInvalid.
inline constexpr const char* kInvalidText =
    " is invalid: its projection or colour is not finite, or it is larger than 1e9 px, farther than 1e12 units or "
    "brighter than 1e9";

struct ProjectedGaussian {
  Outcome outcome = Outcome::kCulled;
  // Defined if the Gaussian is seen:
  std::int32_t n_tiles = 0;  // tiles that the splat touches
  std::int32_t radius = 0;   // 3 standard deviations in px, rounded up
  Vec2f extent{};            // half width and height (px) of the box around alpha >= 1/255
  Splat splat{};             // red, green, blue and clamped are 0
};

/// Projects Gaussian i. With TileCount::kAny `n_tiles` is a lower bound, which is 0 only if the splat touches no tile.
/// `lens`: Pinhole or ViewLens.
template <TileCount kCount, bool kAntialiasing, class Lens>
B3DGS_HD ProjectedGaussian project_splat(const GaussianArrays& gaussians, std::int64_t i,
                                         const ViewTransform<float>& view, const Lens& lens, float near_plane,
                                         Culling culling, const TileGrid& grid) {
  ProjectedGaussian result;
  const Vec3f point = to_camera(view, load3(gaussians.means, i));
  const float depth = lens_depth(lens, point);
  if (!detail::is_finite(point.x + point.y + point.z) || depth > kDepthMax) {
    result.outcome = Outcome::kInvalid;
    return result;
  }
  if (depth < near_plane) return result;

  const Vec3f log_scales = load3(gaussians.log_scales, i);
  const Vec4f quat = load4(gaussians.quats, i);
  const float logit = gaussians.logit_opacities[i];
  if (!detail::is_finite(logit + log_scales.x + log_scales.y + log_scales.z + quat.x + quat.y + quat.z + quat.w)) {
    result.outcome = Outcome::kInvalid;
    return result;
  }
  float log2_opacity = log2_sigmoid(logit);
  if (culling == Culling::kEllipse && log2_opacity < kLog2AlphaMin) return result;

  [[maybe_unused]] Smoothed<float> smoothed{log_scales, {1, 1, 1}, 0};
  if constexpr (kAntialiasing) {
    if (gaussians.filters != nullptr) smoothed = smooth(log_scales, gaussians.filters[i]);
  }
  const Shape<float> shape = make_shape(smoothed.log_scales, quat);
  if constexpr (!std::is_same_v<Lens, Pinhole>) {
    if (is_out_of_lens(lens, point)) return result;
  }
  const Projection<float> p = project_gaussian(view, lens, point, shape.factor);
  if constexpr (!std::is_same_v<Lens, Pinhole>) {
    if (!(p.shrink > 0)) {  // too large for its square to be finite
      result.outcome = Outcome::kInvalid;
      return result;
    }
  }
  if constexpr (kAntialiasing) {
    log2_opacity += kLog2e * (smoothed.log_opacity_ratio + std::log(blur_ratio(p)) / 2);
    if (culling == Culling::kEllipse && log2_opacity < kLog2AlphaMin) return result;
  }
  const float radius = std::ceil(kSquareSigmas * largest_sigma(p.cov));
  if (!detail::is_finite(p.mean2d.x + p.mean2d.y + p.conic.xx + p.conic.xy + p.conic.yy + log2_opacity) ||
      !(radius <= kRadiusMax) || !(shape.inverse_length <= kInverseQuatLengthMax)) {
    result.outcome = Outcome::kInvalid;
    return result;
  }
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
  result.n_tiles = tiles_touched<kCount>(grid, culling, result.splat, result.extent, result.radius);
  if (result.n_tiles > 0) result.outcome = Outcome::kSeen;
  return result;
}

// The seam of a panorama: a splat that crosses it is drawn twice, a full turn apart, each with sums of its own; those
// of the second are added to those of the first before the backward projection.

/// The second splat of a Gaussian that the view sees; its n_tiles is 0 if there is none. `turn`: width of a full turn,
/// px, which is the image's unless that was reduced.
template <TileCount kCount>
B3DGS_HD ProjectedGaussian across_the_seam(const ProjectedGaussian& first, float turn, Culling culling,
                                           const TileGrid& grid) {
  ProjectedGaussian second = first;
  const bool is_left = first.splat.mean_x < static_cast<float>(grid.image_width) / 2;
  second.splat.mean_x = (StrictFloat(first.splat.mean_x) + (is_left ? turn : -turn)).value;
  second.n_tiles = tiles_touched<kCount>(grid, culling, second.splat, second.extent, second.radius);
  return second;
}

// Rendering inverse depth, the sum of weight over depth (RenderSettings::inverse_depth). Binning orders splats
// by their depth; after it, the depth of each splat is replaced by its inverse, which the blend sums like a depth. The
// backward blend then gives the gradient with respect to the inverse. So every kernel renders inverse depth, and none
// has code for it.

B3DGS_HD void invert_depth(Splat& splat) {
  splat.depth = 1.0f / splat.depth;
}

/// Gradient with respect to the depth of a splat whose `depth` is now its inverse, from that with respect to this.
B3DGS_HD float depth_gradient(const Splat& splat, float grad_inverse) {
  return -(splat.depth * splat.depth) * grad_inverse;
}

}  // namespace b3dgs
