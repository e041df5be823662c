// Projection and backward projection, one Gaussian at a time. Threads take chunks of Gaussians.

#include <algorithm>
#include <array>
#include <type_traits>
#include <vector>

#include "core/parallel.h"
#include "raster/cpu/pack_splats.h"
#include "raster/cpu/passes.h"
#include "raster/math/gaussian_grad.h"
#include "raster/math/pixel_outputs.h"
#include "raster/math/project_splat.h"
#include "raster/math/sh.h"

namespace b3dgs::cpu {
namespace {

constexpr std::int64_t kGrain = 1024;  // Gaussians or splats per chunk

/// Projects Gaussian i.
template <bool kAntialiasing, class Lens>
Outcome project_one(const ProjectArgs& args, const ViewTransform<float>& view, const Lens& lens, std::int64_t i,
                    PackedSplats& out) {
  const GaussianArrays& g = args.gaussians;
  ProjectedGaussian projected =
      project_splat<kAntialiasing>(g, i, view, lens, args.settings.near_plane, args.settings.culling, args.grid);
  args.out.radii[i] = 0;
  if (projected.outcome != Outcome::kSeen) return projected.outcome;

  const ShColor<float> color = sh_color(args.settings.sh_degree, load3(g.means, i) - args.view.center, g.sh0 + 3 * i,
                                        g.shN + rest_floats(g.sh_degree_max) * i);
  if (!is_usable_color(color.color.x, color.color.y, color.color.z)) return Outcome::kInvalid;
  args.out.radii[i] = projected.radius;
  projected.splat.red = color.color.x;
  projected.splat.green = color.color.y;
  projected.splat.blue = color.color.z;
  projected.splat.clamped = color.clamped;
  out.add(projected);
  if constexpr (!std::is_same_v<Lens, Pinhole>) {
    if (splats_per_gaussian(args.view.lens) == 2) out.add_second(args, projected);
  }
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

SplatCounts project(const ProjectArgs& args) {
  const ViewTransform<float> view = make_view_transform<float>(args.view);
  const std::int64_t n_each = args.is_drawn ? splats_per_gaussian(args.view.lens) : 1;
  const auto project_valid = [&](std::int64_t i, PackedSplats& out) {
    const Outcome outcome = with_lens(args.view.lens, [&](const auto& lens) {
      return args.settings.antialiasing ? project_one<true>(args, view, lens, i, out)
                                        : project_one<false>(args, view, lens, i, out);
    });
    return outcome != Outcome::kInvalid;
  };
  const PackedSplats all = pack_splats(args.gaussians.n_gaussians, n_each, args.out, project_valid);
  if (all.invalid >= 0) fail_invalid(args.gaussians, all.invalid);
  return {args.is_drawn ? all.n - all.n_second : all.n, all.n_second};
}

void project_backward(const ProjectBackwardArgs& args, const PairSums<SplatGrad>& sums, const GaussianGradArrays& out) {
  const GaussianArrays& g = args.gaussians;
  const ViewTransform<float> view = make_view_transform<float>(args.view);
  const std::int64_t rest = rest_floats(g.sh_degree_max);

  const auto backward_one = [&](std::int64_t i, const Splat& splat, const SplatGrad& sum) {
    const GaussianGrad grad = with_lens(args.view.lens, [&](const auto& lens) {
      using Lens = std::decay_t<decltype(lens)>;
      const auto grad_of = args.antialiasing ? gaussian_grad<true, Lens> : gaussian_grad<false, Lens>;
      return grad_of(g, i, view, lens, args.view.center, args.sh_degree, sum, splat.clamped);
    });
    store3(out.means, i, grad.mean);
    store3(out.log_scales, i, grad.log_scales);
    store4(out.quats, i, grad.quat);
    out.logit_opacities[i] = grad.logit_opacity;
    store3(out.sh0, i, grad.sh0());
    sh_rest_grad(args.sh_degree, grad.dir, grad.color, out.shN + rest * i);
    std::fill(out.shN + rest * i + rest_floats(args.sh_degree), out.shN + rest * (i + 1), 0.0f);
    out.means2d[2 * i] = grad.mean2d.x;
    out.means2d[2 * i + 1] = grad.mean2d.y;
  };

  // Zeroes the gradients of Gaussians [begin, end), which are not visible.
  const auto write_zeros = [&](std::int64_t begin, std::int64_t end) {
    const auto fill = [&](float* array, std::int64_t columns) {
      std::fill(array + columns * begin, array + columns * end, 0.0f);
    };
    for (float* array : {out.means, out.log_scales, out.sh0}) fill(array, 3);
    fill(out.quats, 4);
    fill(out.logit_opacities, 1);
    fill(out.shN, rest);
    fill(out.means2d, 2);
  };
  parallel_chunks(g.n_gaussians, kGrain, [&](std::int64_t begin, std::int64_t end) {
    const Splat* const splats_end = sums.splats + sums.n_splats;
    const Splat* splat =
        std::lower_bound(sums.splats, splats_end, begin, [](const Splat& s, std::int64_t i) { return s.gaussian < i; });
    for (; splat != splats_end && splat->gaussian < end; ++splat) {
      const std::int64_t m = splat - sums.splats;
      if (sums.is_second(m)) continue;
      write_zeros(begin, splat->gaussian);
      backward_one(splat->gaussian, *splat, sums.of_gaussian(m));
      begin = splat->gaussian + 1;
    }
    write_zeros(begin, end);
  });
}

namespace {

// Gradient with respect to the camera's pose. The contributions of the splats are summed in double within chunks of a
// fixed size and then over the chunks in order, so the result does not depend on the number of threads.

using Part = std::array<float, kCameraGradients>;

/// Returns the contribution of a splat, given its sums over pixels.
Part part_of(const ProjectBackwardArgs& args, const ViewTransform<float>& view, const Splat& splat,
             const SplatGrad& sum) {
  const CameraGrad part = with_lens(args.view.lens, [&](const auto& lens) {
    using Lens = std::decay_t<decltype(lens)>;
    const auto grad_of = args.antialiasing ? camera_grad<true, Lens> : camera_grad<false, Lens>;
    return grad_of(args.gaussians, splat.gaussian, view, lens, args.view.center, args.sh_degree, sum, splat.clamped);
  });
  return {part.rotation.x,    part.rotation.y,    part.rotation.z,
          part.translation.x, part.translation.y, part.translation.z};
}

/// Adds the contributions of n splats. get_part(m) returns that of splat m.
template <class GetPart>
void add_parts(std::int64_t n, double* out, GetPart&& get_part) {
  const Chunks chunks = make_chunks(n, kGrain);
  std::vector<std::array<double, kCameraGradients>> sums_of_chunks(static_cast<std::size_t>(chunks.count));
  parallel_pool(chunks.count, [&](std::int64_t chunk, int) {
    std::array<double, kCameraGradients>& sums = sums_of_chunks[static_cast<std::size_t>(chunk)];
    for (std::int64_t m = chunks.begin(chunk), end = chunks.end(chunk); m < end; ++m) {
      const auto part = get_part(m);
      for (std::size_t k = 0; k < sums.size(); ++k) sums[k] += double{part[k]};
    }
  });
  for (std::size_t k = 0; k < kCameraGradients; ++k) {
    out[k] = 0;
    for (const auto& sums : sums_of_chunks) out[k] += sums[k];
  }
}

/// Initialises the entries of Gaussians that are not visible in the view.
void write_unseen(const SplatRecordArrays& out, std::int64_t n_gaussians) {
  parallel_chunks(n_gaussians, kGrain, [&](std::int64_t begin, std::int64_t end) {
    std::fill(out.record_of_gaussian + begin, out.record_of_gaussian + end, -1);
    std::fill(out.means2d + 2 * begin, out.means2d + 2 * end, 0.0f);
  });
}

}  // namespace

void camera_gradient(const ProjectBackwardArgs& args, const PairSums<SplatGrad>& sums, double* out) {
  const ViewTransform<float> view = make_view_transform<float>(args.view);
  add_parts(sums.n_splats, out,
            [&](std::int64_t m) { return part_of(args, view, sums.splats[m], sums.sum(m, m + 1)); });
}

void camera_parts(const ProjectBackwardArgs& args, const SplatRows& rows, const SplatGradSum* splat_grads,
                  float* parts) {
  const ViewTransform<float> view = make_view_transform<float>(args.view);
  parallel_each(rows.n_splats, kGrain, [&](std::int64_t m) {
    const Part part = part_of(args, view, rows.splats[m], splat_grads[m].sum);
    std::copy(part.begin(), part.end(), parts + m * kCameraGradients);
  });
}

void sum_camera_parts(const float* parts, std::int64_t n_splats, double* out) {
  add_parts(n_splats, out, [&](std::int64_t m) { return parts + m * kCameraGradients; });
}

void keep_splat_records(const PairSums<SplatGrad>& sums, std::int64_t n_gaussians, const SplatRecordArrays& out) {
  write_unseen(out, n_gaussians);
  sums.visit_gaussians([&](std::int64_t m, const SplatGrad& sum) {
    keep_splat(out, m, sums.splats[m].gaussian, sum, sums.splats[m].clamped);
  });
}

void add_scores(const AddScoresArgs& args) {
  parallel_each(args.n_splats, kGrain,
                [&](std::int64_t m) { b3dgs::add_scores(args.sums[m], args.out, args.splats[m].gaussian); });
}

void keep_splats(const KeepSplatsArgs& args) {
  write_unseen(args.out, args.n_gaussians);
  std::fill_n(args.radii, args.n_gaussians, 0);
  parallel_each(args.rows.n_splats, kGrain, [&](std::int64_t m) { keep_splat(args, m); });
}

}  // namespace b3dgs::cpu
