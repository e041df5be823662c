// Projection and its backward pass: one Gaussian at a time, chunks of Gaussians over the threads.

#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

#include "core/check.h"
#include "core/parallel.h"
#include "raster/cpu/passes.h"
#include "raster/math/invalid_gaussian.h"
#include "raster/math/project_splat.h"
#include "raster/math/sh.h"

namespace b3dgs::cpu {
namespace {

constexpr std::int64_t kGrain = 1024;

/// Of Gaussian i, which goes into `splat` and `extent` where it is seen.
Outcome project_one(const ProjectArgs& args, const ViewTransform<float>& view, std::int64_t i, Splat& splat,
                    Vec2f& extent) {
  const GaussianArrays& g = args.gaussians;
  const ProjectedGaussian projected =
      project_splat<TileCount::kAny>(g, i, view, args.near_plane, args.culling, args.grid);
  args.radii[i] = 0;
  if (projected.outcome != Outcome::kSeen) return projected.outcome;

  const ShColor<float> color = sh_color(args.sh_degree, load3(g.means, i) - args.view.center, g.sh0 + 3 * i,
                                        g.shN + rest_floats(g.sh_degree_max) * i);
  if (!is_usable_color(color.color.x, color.color.y, color.color.z)) return Outcome::kNotFinite;
  args.radii[i] = projected.radius;
  extent = projected.extent;
  splat = projected.splat;
  splat.red = color.color.x;
  splat.green = color.color.y;
  splat.blue = color.color.z;
  splat.clamped = color.clamped;
  return Outcome::kSeen;
}

[[noreturn]] void fail_not_finite(const GaussianArrays& g, std::int64_t i) {
  const Vec3f mean = load3(g.means, i), scale = load3(g.log_scales, i);
  const Vec4f quat = load4(g.quats, i);
  throw InvalidGaussianError(
      i, detail::concat("Gaussian ", i, kNotFiniteText, ": mean (", mean.x, ", ", mean.y, ", ", mean.z,
                        "), log scales (", scale.x, ", ", scale.y, ", ", scale.z, "), rotation (", quat.x, ", ", quat.y,
                        ", ", quat.z, ", ", quat.w, "), opacity logit ", g.logit_opacities[i], ", colour (",
                        g.sh0[3 * i], ", ", g.sh0[3 * i + 1], ", ", g.sh0[3 * i + 2], ")"));
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
      const Outcome outcome = project_one(args, view, i, args.splats[slot], args.extents[slot]);
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
    store4(args.grad.quats, i, grad_shape.quat);
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
