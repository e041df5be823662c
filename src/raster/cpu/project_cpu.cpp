// Projection and backward projection: one Gaussian at a time; threads take chunks of Gaussians.

#include <algorithm>
#include <vector>

#include "core/parallel.h"
#include "raster/cpu/passes.h"
#include "raster/math/gaussian_grad.h"
#include "raster/math/project_splat.h"
#include "raster/math/sh.h"

namespace b3dgs::cpu {
namespace {

constexpr std::int64_t kGrain = 1024;  // Gaussians per chunk

/// Projects Gaussian i. `splat` and `extent` are written only if it is seen.
template <bool kAntialiasing>
Outcome project_one(const ProjectArgs& args, const ViewTransform<float>& view, std::int64_t i, Splat& splat,
                    Vec2f& extent) {
  const GaussianArrays& g = args.gaussians;
  const ProjectedGaussian projected =
      project_splat<TileCount::kAny, kAntialiasing>(g, i, view, args.near_plane, args.culling, args.grid);
  args.radii[i] = 0;
  if (projected.outcome != Outcome::kSeen) return projected.outcome;

  const ShColor<float> color = sh_color(args.sh_degree, load3(g.means, i) - args.view.center, g.sh0 + 3 * i,
                                        g.shN + rest_floats(g.sh_degree_max) * i);
  if (!is_usable_color(color.color.x, color.color.y, color.color.z)) return Outcome::kInvalid;
  args.radii[i] = projected.radius;
  extent = projected.extent;
  splat = projected.splat;
  splat.red = color.color.x;
  splat.green = color.color.y;
  splat.blue = color.color.z;
  splat.clamped = color.clamped;
  return Outcome::kSeen;
}

[[noreturn]] void fail_invalid(const GaussianArrays& g, std::int64_t i) {
  const Vec3f mean = load3(g.means, i), scale = load3(g.log_scales, i);
  const Vec4f quat = load4(g.quats, i);
  throw InvalidGaussianError(
      i, detail::concat("Gaussian ", i, kInvalidText, ": mean (", mean.x, ", ", mean.y, ", ", mean.z, "), log scales (",
                        scale.x, ", ", scale.y, ", ", scale.z, "), rotation (", quat.x, ", ", quat.y, ", ", quat.z,
                        ", ", quat.w, "), opacity logit ", g.logit_opacities[i], ", colour (", g.sh0[3 * i], ", ",
                        g.sh0[3 * i + 1], ", ", g.sh0[3 * i + 2], ")"));
}

}  // namespace

std::int64_t project(const ProjectArgs& args) {
  const std::int64_t n = args.gaussians.n_gaussians;
  const ViewTransform<float> view = make_view_transform<float>(args.view);

  // Each chunk packs its splats at its chunk_packed beginning; afterwards the chunks are moved together.
  struct Packed {
    std::int64_t n_splats, invalid;
  };
  const Chunks chunks = make_chunks(n, kGrain);
  std::vector<Packed> packed(static_cast<std::size_t>(chunks.count));
  parallel_pool(chunks.count, [&](std::int64_t chunk, int) {
    Packed& chunk_packed = packed[static_cast<std::size_t>(chunk)];
    chunk_packed = {0, n};
    for (std::int64_t i = chunks.begin(chunk); i < chunks.end(chunk); ++i) {
      const std::int64_t slot = chunks.begin(chunk) + chunk_packed.n_splats;
      const Outcome outcome = args.antialiasing
                                  ? project_one<true>(args, view, i, args.splats[slot], args.extents[slot])
                                  : project_one<false>(args, view, i, args.splats[slot], args.extents[slot]);
      if (outcome == Outcome::kSeen) ++chunk_packed.n_splats;
      if (outcome == Outcome::kInvalid) {
        chunk_packed.invalid = i;
        break;
      }
    }
  });

  std::int64_t n_splats = 0;
  for (std::int64_t chunk = 0; chunk < chunks.count; ++chunk) {
    const Packed& chunk_packed = packed[static_cast<std::size_t>(chunk)];
    if (chunk_packed.invalid < n) fail_invalid(args.gaussians, chunk_packed.invalid);
    const std::int64_t begin = chunks.begin(chunk);
    if (n_splats != begin) {
      std::copy_n(args.splats + begin, chunk_packed.n_splats, args.splats + n_splats);
      std::copy_n(args.extents + begin, chunk_packed.n_splats, args.extents + n_splats);
    }
    n_splats += chunk_packed.n_splats;
  }
  return n_splats;
}

void project_backward(const ProjectBackwardArgs& args) {
  const GaussianArrays& g = args.gaussians;
  const ViewTransform<float> view = make_view_transform<float>(args.view);
  const std::int64_t rest = rest_floats(g.sh_degree_max);

  const auto backward_one = [&](std::int64_t i, const Splat& splat, std::int64_t first, std::int64_t last) {
    const SplatGrad sum = sum_slots(args.pair_grads + first, args.pair_grads + last);
    const GaussianGrad grad =
        args.antialiasing ? gaussian_grad<true>(g, i, view, args.view.center, args.sh_degree, sum, splat.clamped)
                          : gaussian_grad<false>(g, i, view, args.view.center, args.sh_degree, sum, splat.clamped);
    store3(args.grad.means, i, grad.mean);
    store3(args.grad.log_scales, i, grad.log_scales);
    store4(args.grad.quats, i, grad.quat);
    args.grad.logit_opacities[i] = grad.logit_opacity;
    store3(args.grad.sh0, i, grad.sh0());
    sh_rest_grad(args.sh_degree, grad.dir, grad.color, args.grad.shN + rest * i);
    args.grad.means2d[2 * i] = grad.mean2d.x;
    args.grad.means2d[2 * i + 1] = grad.mean2d.y;
  };

  // Rows are zeroed first, for Gaussians that are not seen and for coefficients above the rendered degree.
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
