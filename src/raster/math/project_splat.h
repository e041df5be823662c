// One Gaussian to the splat of one view, but for its colour: what is culled, what is not finite, what is seen. The
// projections on CPU and GPU are loops around this.
#pragma once

#include <cmath>
#include <cstdint>

#include "raster/args.h"
#include "raster/math/projection.h"
#include "raster/math/array_rows.h"
#include "raster/math/tiling.h"

namespace b3dgs {

namespace detail {

/// log2 of the logistic function, exact in both tails.
B3DGS_HD float log2_sigmoid(float logit) {
  constexpr float kLog2e = 1.44269504f;
#if defined(__CUDA_ARCH__)
  const float tail = log1pf(__expf(-fabsf(logit)));  // where __expf is off, its value is far below 1
#else
  const float tail = std::log1p(std::exp(-std::fabs(logit)));
#endif
  return -kLog2e * (logit >= 0 ? tail : tail - logit);
}

B3DGS_HD bool is_finite(float value) {
#if defined(__CUDA_ARCH__)
  return ::isfinite(value);
#else
  return std::isfinite(value);
#endif
}

}  // namespace detail

enum class Outcome {
  kSeen,       // the splat touches a tile
  kCulled,     // before the near plane, too faint, or beside the image
  kNotFinite,  // a parameter or the projection is not finite, or beyond what constants.h allows
};

/// What an error says of such a Gaussian.
inline constexpr const char* kNotFiniteText =
    " has no finite projection and colour, or is larger than 1e9 px, farther than 1e12 units or brighter than 1e9";

struct ProjectedGaussian {
  Outcome outcome = Outcome::kCulled;
  // The rest where the Gaussian is seen.
  std::int32_t n_tiles = 0;  // that it touches
  std::int32_t radius = 0;   // 3 standard deviations in px, rounded up
  Vec2f extent{};            // half width and height (px) of the box around alpha >= 1/255
  Splat splat{};             // colour and `clamped` are 0
};

/// Projects Gaussian i, whose colour plays no part. With TileCount::kAny `n_tiles` is a lower bound, 0 only for 0.
template <TileCount kCount>
B3DGS_HD ProjectedGaussian project_splat(const GaussianArrays& gaussians, std::int64_t i,
                                         const ViewTransform<float>& view, float near_plane, Culling culling,
                                         const TileGrid& grid) {
  ProjectedGaussian result;
  const Vec3f point = to_camera(view, load3(gaussians.means, i));
  if (!detail::is_finite(point.x + point.y + point.z) || point.z > kDepthMax) {
    result.outcome = Outcome::kNotFinite;
    return result;
  }
  if (point.z < near_plane) return result;

  const Vec3f log_scales = load3(gaussians.log_scales, i);
  const Vec4f quat = load4(gaussians.quats, i);
  const float logit = gaussians.logit_opacities[i];
  if (!detail::is_finite(logit + log_scales.x + log_scales.y + log_scales.z + quat.x + quat.y + quat.z + quat.w)) {
    result.outcome = Outcome::kNotFinite;
    return result;
  }
  const float log2_opacity = detail::log2_sigmoid(logit);
  if (culling == Culling::kEllipse && log2_opacity < kLog2AlphaMin) return result;

  const Shape<float> shape = make_shape(log_scales, quat);
  const Projection<float> p = project_gaussian(view, point, shape.factor);
  const float radius = std::ceil(kSquareSigmas * largest_sigma(p.cov));
  if (!detail::is_finite(p.mean2d.x + p.mean2d.y + p.conic.xx + p.conic.xy + p.conic.yy + log2_opacity) ||
      !(radius <= kRadiusMax) || !(shape.inverse_length <= kInverseQuatLengthMax)) {
    result.outcome = Outcome::kNotFinite;
    return result;
  }
  result.radius = static_cast<std::int32_t>(radius);
  result.extent = ellipse_extent(log2_opacity, p.cov);
  result.splat = {p.mean2d.x,
                  p.mean2d.y,
                  log2_opacity,
                  point.z,
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

}  // namespace b3dgs
