#include "train/density_statistics.h"

#if B3DGS_TORCH_CUDA
#include "raster/torch_launch.h"
#include "train/cuda/density_statistics_cuda.h"
#endif

namespace b3dgs {

DensityStatistics make_density_statistics(std::int64_t n_gaussians, torch::Device device) {
  const auto counts = torch::TensorOptions(torch::kInt32).device(device);
  return {torch::zeros({n_gaussians}, counts.dtype(torch::kFloat32)), torch::zeros({n_gaussians}, counts),
          torch::zeros({n_gaussians}, counts)};
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
  const torch::Tensor dx = view.means2d_grad.select(1, 0) * (0.5 * width);
  const torch::Tensor dy = view.means2d_grad.select(1, 1) * (0.5 * height);
  // Gaussians that were not seen have no gradient: their sums do not change.
  statistics.grad_norm_sum += (dx * dx + dy * dy).sqrt();
  statistics.view_count += view.radii > 0;
  statistics.max_radii = torch::maximum(statistics.max_radii, view.radii);
}

}  // namespace b3dgs
