// Gradient with respect to the camera's pose: the splats' parts, summed in double within chunks of a fixed size and
// then over the chunks in their order, so that the result does not depend on the number of threads.

#include <array>
#include <vector>

#include "core/parallel.h"
#include "raster/cpu/passes.h"
#include "raster/cpu/slot_sums.h"
#include "raster/math/camera_grad.h"

namespace b3dgs::cpu {

void camera_gradient(const ProjectBackwardArgs& args, double* out) {
  constexpr std::int64_t kGrain = 1024;  // splats per chunk
  const ViewTransform<float> view = make_view_transform<float>(args.view);
  const auto add_splat = [&](std::int64_t m, std::array<double, kCameraGradients>& sums) {
    const Splat& splat = args.splats[m];
    const SplatGrad sum = sum_slots(args.pair_grads + args.slot_offsets[m], args.pair_grads + args.slot_offsets[m + 1]);
    const auto grad = args.antialiasing ? camera_grad<true> : camera_grad<false>;
    const CameraGrad part =
        grad(args.gaussians, splat.gaussian, view, args.view.center, args.sh_degree, sum, splat.clamped);
    const float values[kCameraGradients]{part.rotation.x,    part.rotation.y,    part.rotation.z,
                                         part.translation.x, part.translation.y, part.translation.z};
    for (std::size_t k = 0; k < sums.size(); ++k) sums[k] += double{values[k]};
  };

  const Chunks chunks = make_chunks(args.n_splats, kGrain);
  std::vector<std::array<double, kCameraGradients>> parts(static_cast<std::size_t>(chunks.count));
  parallel_pool(chunks.count, [&](std::int64_t chunk, int) {
    std::array<double, kCameraGradients>& sums = parts[static_cast<std::size_t>(chunk)];
    for (std::int64_t m = chunks.begin(chunk); m < chunks.end(chunk); ++m) add_splat(m, sums);
  });
  for (int k = 0; k < kCameraGradients; ++k) {
    out[k] = 0;
    for (const auto& sums : parts) out[k] += sums[static_cast<std::size_t>(k)];
  }
}

}  // namespace b3dgs::cpu
