// Projection and backward projection: one Gaussian at a time; threads take chunks of Gaussians.

#include <algorithm>
#include <array>
#include <type_traits>
#include <vector>

#include "core/parallel.h"
#include "raster/cpu/pack_splats.h"
#include "raster/cpu/passes.h"
#include "raster/math/gaussian_grad.h"
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
      project_splat<TileCount::kAny, kAntialiasing>(g, i, view, lens, args.near_plane, args.culling, args.grid);
  args.radii[i] = 0;
  if (projected.outcome != Outcome::kSeen) return projected.outcome;

  const ShColor<float> color = sh_color(args.sh_degree, load3(g.means, i) - args.view.center, g.sh0 + 3 * i,
                                        g.shN + rest_floats(g.sh_degree_max) * i);
  if (!is_usable_color(color.color.x, color.color.y, color.color.z)) return Outcome::kInvalid;
  args.radii[i] = projected.radius;
  projected.splat.red = color.color.x;
  projected.splat.green = color.color.y;
  projected.splat.blue = color.color.z;
  projected.splat.clamped = color.clamped;
  out.add(projected);
  if constexpr (!std::is_same_v<Lens, Pinhole>) {
    if (splats_per_gaussian(args.view.lens) == 2) add_second(args, projected, out);
  }
  return Outcome::kSeen;
}

/// The sums of splat m, the first of its Gaussian, and of the second, whose slots follow.
SplatGrad sum_of_gaussian(const Splat* splats, std::int64_t n_splats, const std::int64_t* slot_offsets,
                          const SplatGrad* pair_grads, std::int64_t m) {
  const std::int64_t last = m + 1 < n_splats && is_across_the_seam(splats, m + 1) ? m + 2 : m + 1;
  return sum_slots(pair_grads + slot_offsets[m], pair_grads + slot_offsets[last]);
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
      return args.antialiasing ? project_one<true>(args, view, lens, i, out)
                               : project_one<false>(args, view, lens, i, out);
    });
    return outcome != Outcome::kInvalid;
  };
  const PackedSplats all = pack_splats(args.gaussians.n_gaussians, n_each, args, project_valid);
  if (all.invalid >= 0) fail_invalid(args.gaussians, all.invalid);
  return {args.is_drawn ? all.n - all.n_second : all.n, all.n_second};
}

void project_backward(const ProjectBackwardArgs& args) {
  const GaussianArrays& g = args.gaussians;
  const ViewTransform<float> view = make_view_transform<float>(args.view);
  const std::int64_t rest = rest_floats(g.sh_degree_max);

  const auto backward_one = [&](std::int64_t i, const Splat& splat, const SplatGrad& sum) {
    const GaussianGrad grad = with_lens(args.view.lens, [&](const auto& lens) {
      const auto grad_of = args.antialiasing ? gaussian_grad<true, std::decay_t<decltype(lens)>>
                                             : gaussian_grad<false, std::decay_t<decltype(lens)>>;
      return grad_of(g, i, view, lens, args.view.center, args.sh_degree, sum, splat.clamped);
    });
    store3(args.grad.means, i, grad.mean);
    store3(args.grad.log_scales, i, grad.log_scales);
    store4(args.grad.quats, i, grad.quat);
    args.grad.logit_opacities[i] = grad.logit_opacity;
    store3(args.grad.sh0, i, grad.sh0());
    sh_rest_grad(args.sh_degree, grad.dir, grad.color, args.grad.shN + rest * i);
    std::fill(args.grad.shN + rest * i + rest_floats(args.sh_degree), args.grad.shN + rest * (i + 1), 0.0f);
    args.grad.means2d[2 * i] = grad.mean2d.x;
    args.grad.means2d[2 * i + 1] = grad.mean2d.y;
  };

  // Rows of Gaussians [begin, end), which are not seen.
  const auto write_zeros = [&](std::int64_t begin, std::int64_t end) {
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
  };
  parallel_chunks(g.n_gaussians, kGrain, [&](std::int64_t begin, std::int64_t end) {
    const Splat* splat = std::lower_bound(args.splats, args.splats + args.n_splats, begin,
                                          [](const Splat& s, std::int64_t i) { return s.gaussian < i; });
    for (; splat != args.splats + args.n_splats && splat->gaussian < end; ++splat) {
      const std::int64_t m = splat - args.splats;
      if (is_across_the_seam(args.splats, m)) continue;
      write_zeros(begin, splat->gaussian);
      backward_one(splat->gaussian, *splat,
                   sum_of_gaussian(args.splats, args.n_splats, args.slot_offsets, args.pair_grads, m));
      begin = splat->gaussian + 1;
    }
    write_zeros(begin, end);
  });
}

namespace {

// Gradient with respect to the camera's pose: the splats' parts, summed in double within chunks of a fixed size and
// then over the chunks in their order, so that the result does not depend on the number of threads.

using Part = std::array<float, kCameraGradients>;

/// What a splat adds, given its sums over pixels.
Part part_of(const CameraPartsView& view, const ViewTransform<float>& transform, const Splat& splat,
             const SplatGrad& sum) {
  const CameraGrad part = with_lens(view.view.lens, [&](const auto& lens) {
    using Lens = std::decay_t<decltype(lens)>;
    const auto grad_of = view.antialiasing ? camera_grad<true, Lens> : camera_grad<false, Lens>;
    return grad_of(view.gaussians, splat.gaussian, transform, lens, view.view.center, view.sh_degree, sum,
                   splat.clamped);
  });
  return {part.rotation.x,    part.rotation.y,    part.rotation.z,
          part.translation.x, part.translation.y, part.translation.z};
}

/// Adds the parts of n splats; get_part(m) is that of splat m.
template <class GetPart>
void add_parts(std::int64_t n, double* out, GetPart&& get_part) {
  const Chunks chunks = make_chunks(n, kGrain);
  std::vector<std::array<double, kCameraGradients>> sums_of_chunks(static_cast<std::size_t>(chunks.count));
  parallel_pool(chunks.count, [&](std::int64_t chunk, int) {
    std::array<double, kCameraGradients>& sums = sums_of_chunks[static_cast<std::size_t>(chunk)];
    for (std::int64_t m = chunks.begin(chunk), end = chunks.end(chunk); m < end; ++m) {
      const Part part = get_part(m);
      for (std::size_t k = 0; k < sums.size(); ++k) sums[k] += double{part[k]};
    }
  });
  for (std::size_t k = 0; k < kCameraGradients; ++k) {
    out[k] = 0;
    for (const auto& sums : sums_of_chunks) out[k] += sums[k];
  }
}

}  // namespace

void camera_gradient(const ProjectBackwardArgs& args, double* out) {
  const ViewTransform<float> transform = make_view_transform<float>(args.view);
  const CameraPartsView view{args.gaussians, args.view, args.sh_degree, args.antialiasing};
  add_parts(args.n_splats, out, [&](std::int64_t m) {
    const SplatGrad* const pairs = args.pair_grads;
    return part_of(view, transform, args.splats[m],
                   sum_slots(pairs + args.slot_offsets[m], pairs + args.slot_offsets[m + 1]));
  });
}

void camera_parts(const CameraPartsArgs& args) {
  const ViewTransform<float> transform = make_view_transform<float>(args.of.view);
  parallel_each(args.n_splats, kGrain, [&](std::int64_t m) {
    const Part part = part_of(args.of, transform, args.splats[m], args.splat_grads[m].sum);
    std::copy(part.begin(), part.end(), args.out + m * kCameraGradients);
  });
}

void sum_camera_parts(const float* parts, std::int64_t n_splats, double* out) {
  add_parts(n_splats, out, [&](std::int64_t m) {
    Part part;
    std::copy_n(parts + m * kCameraGradients, kCameraGradients, part.begin());
    return part;
  });
}

namespace {

/// The rows of Gaussians that the view does not see.
void write_unseen(const SplatRecordArrays& out, std::int64_t n_gaussians) {
  parallel_chunks(n_gaussians, kGrain, [&](std::int64_t begin, std::int64_t end) {
    std::fill(out.record_of_gaussian + begin, out.record_of_gaussian + end, -1);
    std::fill(out.means2d + 2 * begin, out.means2d + 2 * end, 0.0f);
  });
}

}  // namespace

void keep_splat_records(const SplatRecordArgs& args) {
  write_unseen(args.out, args.n_gaussians);
  parallel_each(args.n_splats, kGrain, [&](std::int64_t m) {
    if (is_across_the_seam(args.splats, m)) return;
    const SplatGrad sum = sum_of_gaussian(args.splats, args.n_splats, args.slot_offsets, args.pair_grads, m);
    keep_splat(args.out, m, args.splats[m].gaussian, sum, args.splats[m].clamped);
  });
}

void sum_splat_grads(const SumSplatGradsArgs& args) {
  parallel_each(args.n_splats, kGrain, [&](std::int64_t m) {
    const SplatGrad* const pairs = args.pair_grads;
    args.out[m] = {sum_slots(pairs + args.slot_offsets[m], pairs + args.slot_offsets[m + 1]), {0, 0}};
  });
}

void keep_splats(const KeepSplatsArgs& args) {
  write_unseen(args.out, args.n_gaussians);
  parallel_chunks(args.n_gaussians, kGrain,
                  [&](std::int64_t begin, std::int64_t end) { std::fill(args.radii + begin, args.radii + end, 0); });
  parallel_each(args.rows.n_splats, kGrain, [&](std::int64_t m) { keep_splat(args, m); });
}

}  // namespace b3dgs::cpu
