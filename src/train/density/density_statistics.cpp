#include "train/density/density_statistics.h"

#include <algorithm>
#include <cmath>

#include "core/parallel.h"

#if B3DGS_TORCH_CUDA
#include "raster/torch/torch_launch.h"
#include "train/density/density_statistics_cuda.h"
#endif

namespace b3dgs {

DensityStatistics make_density_statistics(std::int64_t n_gaussians, torch::Device device) {
  const auto counts = torch::TensorOptions(torch::kInt32).device(device);
  DensityStatistics statistics;
  statistics.grad_norm_sum = torch::zeros({n_gaussians}, counts.dtype(torch::kFloat32));
  statistics.view_count = torch::zeros({n_gaussians}, counts);
  statistics.max_radii = torch::zeros({n_gaussians}, counts);
  return statistics;
}

void add_view(const ViewStatistics& view, std::int32_t width, std::int32_t height, DensityStatistics& statistics) {
#if B3DGS_TORCH_CUDA
  if (view.radii.is_cuda()) {
    cuda::AddViewArgs args;
    args.n_gaussians = view.radii.numel();
    args.means2d_grad = view.means2d_grad.data_ptr<float>();
    args.radii = view.radii.data_ptr<std::int32_t>();
    args.half_width = 0.5f * static_cast<float>(width);
    args.half_height = 0.5f * static_cast<float>(height);
    args.grad_norm_sum = statistics.grad_norm_sum.data_ptr<float>();
    args.view_count = statistics.view_count.data_ptr<std::int32_t>();
    args.max_radii = statistics.max_radii.data_ptr<std::int32_t>();
    return cuda::add_view(args, torch_launch_context().stream);
  }
#endif
  // No temporary tensor: a step may run out of memory before its first change to the model, but not here.
  constexpr std::int64_t kGrain = 4096;
  const float half_width = 0.5f * static_cast<float>(width), half_height = 0.5f * static_cast<float>(height);
  const auto* const gradients = view.means2d_grad.data_ptr<float>();
  const auto* const radii = view.radii.data_ptr<std::int32_t>();
  auto* const sums = statistics.grad_norm_sum.data_ptr<float>();
  auto* const counts = statistics.view_count.data_ptr<std::int32_t>();
  auto* const max_radii = statistics.max_radii.data_ptr<std::int32_t>();
  parallel_chunks(view.radii.numel(), kGrain, [&](std::int64_t begin, std::int64_t end) {
    for (std::int64_t i = begin; i < end; ++i) {
      // The gradient of a Gaussian that was not seen is 0, so its sum does not change.
      const float dx = gradients[2 * i] * half_width, dy = gradients[2 * i + 1] * half_height;
      sums[i] += std::sqrt(dx * dx + dy * dy);
      counts[i] += radii[i] > 0;
      max_radii[i] = std::max(max_radii[i], radii[i]);
    }
  });
}

}  // namespace b3dgs
