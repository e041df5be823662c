// Projection and its backward pass: one Gaussian at a time, chunks of Gaussians over the threads.

#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

#include "check.h"
#include "parallel.h"
#include "raster/cpu/passes.h"
#include "raster/projection.h"
#include "raster/sh.h"
#include "raster/tiling.h"

namespace b3dgs::cpu {
namespace {

constexpr float kLog2e = 1.44269504f;
constexpr std::int64_t kGrain = 1024;

Vec3f load3(const float* array, std::int64_t i) {
  return {array[3 * i], array[3 * i + 1], array[3 * i + 2]};
}
Vec4f load4(const float* array, std::int64_t i) {
  return {array[4 * i], array[4 * i + 1], array[4 * i + 2], array[4 * i + 3]};
}
void store3(float* array, std::int64_t i, Vec3f v) {
  array[3 * i] = v.x;
  array[3 * i + 1] = v.y;
  array[3 * i + 2] = v.z;
}

enum class Outcome { kSeen, kCulled, kNotFinite };

/// log2 of the logistic function, exact in both tails.
float log2_sigmoid(float logit) {
  const float tail = std::log1p(std::exp(-std::fabs(logit)));
  return -kLog2e * (logit >= 0 ? tail : tail - logit);
}

Outcome project_one(const ProjectArgs& args, const ViewTransform<float>& view, std::int64_t i, Splat& splat,
                    Vec2f& extent, std::int32_t& radius) {
  const GaussianArrays& g = args.gaussians;
  const Vec3f mean = load3(g.means, i);
  const Vec3f point = to_camera(view, mean);
  if (!std::isfinite(point.x + point.y + point.z)) return Outcome::kNotFinite;
  if (point.z < args.near_plane) return Outcome::kCulled;

  const Vec3f log_scales = load3(g.log_scales, i);
  const Vec4f quat = load4(g.quats, i);
  if (!std::isfinite(g.logit_opacities[i] + log_scales.x + log_scales.y + log_scales.z + quat.x + quat.y + quat.z +
                     quat.w)) {
    return Outcome::kNotFinite;
  }
  const float log2_opacity = log2_sigmoid(g.logit_opacities[i]);
  if (args.culling == Culling::kEllipse && log2_opacity < kLog2AlphaMin) return Outcome::kCulled;

  const Shape<float> shape = make_shape(log_scales, quat);
  const Projection<float> p = project_gaussian(view, point, shape.factor);
  const float radius_px = std::ceil(kSquareSigmas * largest_sigma(p.cov));
  if (!std::isfinite(p.mean2d.x + p.mean2d.y + p.conic.xx + p.conic.xy + p.conic.yy + log2_opacity) ||
      !(radius_px <= kRadiusMax)) {
    return Outcome::kNotFinite;
  }
  radius = static_cast<std::int32_t>(radius_px);
  extent = ellipse_extent(log2_opacity, p.cov);
  const Rect tiles = args.culling == Culling::kSquare
                         ? square_tiles(args.grid, p.mean2d.x, p.mean2d.y, static_cast<float>(radius))
                         : box_tiles(args.grid, p.mean2d.x, p.mean2d.y, extent);
  if (tiles.empty()) return Outcome::kCulled;

  const std::int64_t rest = rest_floats(g.sh_degree_max);
  const ShColor<float> color = sh_color(args.sh_degree, mean - args.view.center, g.sh0 + 3 * i, g.shN + rest * i);
  if (!std::isfinite(color.color.x + color.color.y + color.color.z)) return Outcome::kNotFinite;

  splat = {p.mean2d.x,
           p.mean2d.y,
           log2_opacity,
           point.z,
           kConicScale * p.conic.xx,
           kConicScale * p.conic.xy,
           kConicScale * p.conic.yy,
           static_cast<std::int32_t>(i),
           color.color.x,
           color.color.y,
           color.color.z,
           color.clamped};
  return Outcome::kSeen;
}

[[noreturn]] void fail_not_finite(const GaussianArrays& g, std::int64_t i) {
  const Vec3f mean = load3(g.means, i), scale = load3(g.log_scales, i);
  const Vec4f quat = load4(g.quats, i);
  throw NumericError(detail::concat("Gaussian ", i, " has no finite projection, or one of more than 1e9 px: mean (",
                                    mean.x, ", ", mean.y, ", ", mean.z, "), log scales (", scale.x, ", ", scale.y, ", ",
                                    scale.z, "), rotation (", quat.x, ", ", quat.y, ", ", quat.z, ", ", quat.w,
                                    "), opacity logit ", g.logit_opacities[i], ", colour (", g.sh0[3 * i], ", ",
                                    g.sh0[3 * i + 1], ", ", g.sh0[3 * i + 2], ")"));
}

}  // namespace

std::int64_t project(const ProjectArgs& args) {
  const std::int64_t n = args.gaussians.n_gaussians;
  B3DGS_CHECK(n < std::numeric_limits<std::int32_t>::max(), "splats carry 32-bit indices; n_gaussians is ", n);
  const ViewTransform<float> view = make_view_transform<float>(args.view);

  // Each chunk's splats are packed at the chunk's beginning; then the chunks are moved together.
  struct Packed {
    std::int64_t n_splats, not_finite;
  };
  const Chunks chunks = make_chunks(n, kGrain);
  std::vector<Packed> packed(static_cast<std::size_t>(chunks.count));
  parallel_pool(chunks.count, [&](std::int64_t chunk, int) {
    Packed& own = packed[static_cast<std::size_t>(chunk)];
    own = {0, n};
    for (std::int64_t i = chunks.begin(chunk); i < chunks.end(chunk); ++i) {
      const std::int64_t slot = chunks.begin(chunk) + own.n_splats;
      std::int32_t radius = 0;
      const Outcome outcome = project_one(args, view, i, args.splats[slot], args.extents[slot], radius);
      args.radii[i] = outcome == Outcome::kSeen ? radius : 0;
      if (outcome == Outcome::kSeen) ++own.n_splats;
      if (outcome == Outcome::kNotFinite) {
        own.not_finite = i;
        break;
      }
    }
  });

  std::int64_t n_splats = 0;
  for (std::int64_t chunk = 0; chunk < chunks.count; ++chunk) {
    const Packed& own = packed[static_cast<std::size_t>(chunk)];
    if (own.not_finite < n) fail_not_finite(args.gaussians, own.not_finite);
    const std::int64_t begin = chunks.begin(chunk);
    if (n_splats != begin) {
      std::copy_n(args.splats + begin, own.n_splats, args.splats + n_splats);
      std::copy_n(args.extents + begin, own.n_splats, args.extents + n_splats);
    }
    n_splats += own.n_splats;
  }
  return n_splats;
}

void project_backward(const ProjectBackwardArgs& args) {
  const GaussianArrays& g = args.gaussians;
  const ViewTransform<float> view = make_view_transform<float>(args.view);
  const std::int64_t rest = rest_floats(g.sh_degree_max);
  const std::int64_t rendered_rest = rest_floats(args.sh_degree);

  const auto backward_one = [&](std::int64_t i, const Splat& splat, std::int64_t first, std::int64_t last) {
    SplatGrad sum{};
    for (std::int64_t slot = first; slot < last; ++slot) {
      const SplatGrad& part = args.isect_grads[slot];
      sum.q += part.q;
      sum.q_x += part.q_x;
      sum.q_y += part.q_y;
      sum.q_xx += part.q_xx;
      sum.q_xy += part.q_xy;
      sum.q_yy += part.q_yy;
      sum.red += part.red;
      sum.green += part.green;
      sum.blue += part.blue;
      sum.depth += part.depth;
    }
    const Vec3f mean = load3(g.means, i);
    const Vec3f point = to_camera(view, mean);
    const Shape<float> shape = make_shape(load3(g.log_scales, i), load4(g.quats, i));
    const Projection<float> p = project_gaussian(view, point, shape.factor);
    const ProjectionGrad<float> grad = b3dgs::project_backward(view, point, shape.factor, p, Vec2f{sum.q_x, sum.q_y},
                                                               Sym2f{sum.q_xx, sum.q_xy, sum.q_yy}, sum.depth);
    const ShapeGrad<float> grad_shape = shape_backward(shape, grad.factor);

    const Vec3f grad_color{splat.clamped & 1u ? 0.0f : sum.red, splat.clamped & 2u ? 0.0f : sum.green,
                           splat.clamped & 4u ? 0.0f : sum.blue};
    const Vec3f grad_offset = sh_color_backward(args.sh_degree, mean - args.view.center, g.shN + rest * i, grad_color,
                                                args.grad.sh0 + 3 * i, args.grad.shN + rest * i);
    std::fill(args.grad.shN + rest * i + rendered_rest, args.grad.shN + rest * (i + 1), 0.0f);

    store3(args.grad.means, i, transpose_times(view.rotation, grad.point) + grad_offset);
    store3(args.grad.log_scales, i, grad_shape.log_scales);
    args.grad.quats[4 * i] = grad_shape.quat.x;
    args.grad.quats[4 * i + 1] = grad_shape.quat.y;
    args.grad.quats[4 * i + 2] = grad_shape.quat.z;
    args.grad.quats[4 * i + 3] = grad_shape.quat.w;
    // q is the gradient by ln(opacity), and d ln(sigmoid(x)) / dx = 1 - sigmoid(x) = sigmoid(-x).
    args.grad.logit_opacities[i] = sum.q / (1 + std::exp(g.logit_opacities[i]));
    args.grad.means2d[2 * i] = grad.mean2d.x;
    args.grad.means2d[2 * i + 1] = grad.mean2d.y;
  };

  parallel_chunks(g.n_gaussians, kGrain, [&](std::int64_t begin, std::int64_t end) {
    const auto fill = [&](float* array, std::int64_t columns) {
      std::fill(array + columns * begin, array + columns * end, 0.0f);
    };
    fill(args.grad.means, 3);
    fill(args.grad.log_scales, 3);
    fill(args.grad.quats, 4);
    fill(args.grad.logit_opacities, 1);
    fill(args.grad.sh0, 3);
    fill(args.grad.shN, rest);
    fill(args.grad.means2d, 2);
    const Splat* splat = std::lower_bound(args.splats, args.splats + args.n_splats, begin,
                                          [](const Splat& s, std::int64_t i) { return s.gaussian < i; });
    for (; splat != args.splats + args.n_splats && splat->gaussian < end; ++splat) {
      const std::int64_t m = splat - args.splats;
      backward_one(splat->gaussian, *splat, args.slot_offsets[m], args.slot_offsets[m + 1]);
    }
  });
}

}  // namespace b3dgs::cpu
