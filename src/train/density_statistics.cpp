#include "train/density_statistics.h"

namespace b3dgs {

DensityStatistics make_density_statistics(std::int64_t n_gaussians, torch::Device device) {
  const auto counts = torch::TensorOptions(torch::kInt32).device(device);
  return {torch::zeros({n_gaussians}, counts.dtype(torch::kFloat32)), torch::zeros({n_gaussians}, counts),
          torch::zeros({n_gaussians}, counts)};
}

void add_view(const ViewStatistics& view, std::int32_t width, std::int32_t height, DensityStatistics& statistics) {
  const torch::Tensor dx = view.means2d_grad.select(1, 0) * (0.5 * width);
  const torch::Tensor dy = view.means2d_grad.select(1, 1) * (0.5 * height);
  // Gaussians that were not seen have no gradient: their sums do not change.
  statistics.grad_norm_sum += (dx * dx + dy * dy).sqrt();
  statistics.view_count += view.radii > 0;
  statistics.max_radii = torch::maximum(statistics.max_radii, view.radii);
}

}  // namespace b3dgs
