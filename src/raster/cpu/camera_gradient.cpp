// Gradient with respect to the camera's pose: the splats' parts, summed in double within chunks of a fixed size and
// then over the chunks in their order, so that the result does not depend on the number of threads.

#include <algorithm>
#include <array>
#include <vector>

#include "core/parallel.h"
#include "raster/cpu/passes.h"
#include "raster/math/gaussian_grad.h"

namespace b3dgs::cpu {
namespace {

using Part = std::array<float, kCameraGradients>;

/// What a splat adds, given its sums over pixels.
Part part_of(const CameraPartsView& view, const ViewTransform<float>& transform, const Splat& splat,
             const SplatGrad& sum) {
  const auto grad = view.antialiasing ? camera_grad<true> : camera_grad<false>;
  const CameraGrad part =
      grad(view.gaussians, splat.gaussian, transform, view.view.center, view.sh_degree, sum, splat.clamped);
  return {part.rotation.x,    part.rotation.y,    part.rotation.z,
          part.translation.x, part.translation.y, part.translation.z};
}

/// Adds the parts of n splats; get_part(m) is that of splat m.
template <class GetPart>
void add_parts(std::int64_t n, double* out, GetPart&& get_part) {
  constexpr std::int64_t kGrain = 1024;  // splats per chunk
  const Chunks chunks = make_chunks(n, kGrain);
  std::vector<std::array<double, kCameraGradients>> sums_of_chunks(static_cast<std::size_t>(chunks.count));
  parallel_pool(chunks.count, [&](std::int64_t chunk, int) {
    std::array<double, kCameraGradients>& sums = sums_of_chunks[static_cast<std::size_t>(chunk)];
    for (std::int64_t m = chunks.begin(chunk); m < chunks.end(chunk); ++m) {
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
  constexpr std::int64_t kGrain = 1024;
  parallel_chunks(args.n_splats, kGrain, [&](std::int64_t begin, std::int64_t end) {
    for (std::int64_t m = begin; m < end; ++m) {
      const Part part = part_of(args.of, transform, args.splats[m], args.sums[m].sum);
      std::copy(part.begin(), part.end(), args.out + m * kCameraGradients);
    }
  });
}

void sum_camera_parts(const float* parts, std::int64_t n_splats, double* out) {
  add_parts(n_splats, out, [&](std::int64_t m) {
    Part part;
    std::copy_n(parts + m * kCameraGradients, kCameraGradients, part.begin());
    return part;
  });
}

}  // namespace b3dgs::cpu
