#include "train/gaussians/floaters.h"

#include <algorithm>

namespace b3dgs {
namespace {

constexpr double kSeenWeight = 1.0 / 255, kCloseShare = 0.1, kLargeShare = 0.3;
constexpr std::int64_t kGaussianColumn = 7;   // of ViewSplats::splats
constexpr std::int64_t kMaxWeightColumn = 4;  // of Rasterizer::score_splats()

/// Median depth of the pixels with alpha over 0.5, world units; 0 if there are none.
torch::Tensor median_depth(const RenderedView& rendered) {
  const torch::Tensor depths = (rendered.depth / rendered.alpha).masked_select(rendered.alpha > 0.5);
  return depths.numel() > 0 ? depths.median() : torch::full({}, 0.0, depths.options());
}

}  // namespace

FloaterCount count_floaters(Rasterizer& rasterizer, const GaussianTensors& gaussians,
                            const std::vector<PinholeView>& views, const RenderSettings& settings) {
  RenderSettings forward_only = settings;
  forward_only.keep_for_backward = false;
  const torch::TensorOptions floats = gaussians.means.options();
  torch::Tensor n_views = torch::zeros({gaussians.size()}, floats.dtype(torch::kInt32));
  torch::Tensor is_close = torch::zeros({gaussians.size()}, floats.dtype(torch::kBool));
  torch::Tensor is_large = torch::zeros_like(is_close);
  for (const PinholeView& view : views) {
    const ViewSplats splats = rasterizer.project(gaussians, view, forward_only);
    if (splats.size() == 0) continue;
    const torch::Tensor near_depth = kCloseShare * median_depth(rasterizer.forward_splats(splats, view, forward_only));
    const torch::Tensor sums = rasterizer.score_splats(torch::zeros({view.height, view.width}, floats));
    const torch::Tensor weights = sums.select(1, kMaxWeightColumn).contiguous().view(torch::kFloat32);
    const torch::Tensor seen = (weights >= kSeenWeight).nonzero().flatten();
    const torch::Tensor ids = splats.splats.select(1, kGaussianColumn).contiguous().view(torch::kInt32);
    const torch::Tensor rows = ids.index_select(0, seen).to(torch::kInt64);
    n_views.index_add_(0, rows, torch::ones_like(rows, n_views.options()));
    const torch::Tensor center = torch::tensor({view.center.x, view.center.y, view.center.z}, floats);
    const torch::Tensor distances = (gaussians.means.index_select(0, rows) - center).norm(2, 1);
    is_close.index_fill_(0, rows.masked_select(distances < near_depth), true);
    const torch::Tensor radii = splats.radii.index_select(0, seen);
    is_large.index_fill_(0, rows.masked_select(radii > kLargeShare * std::max(view.width, view.height)), true);
  }
  const auto count = [](const torch::Tensor& mask) { return mask.sum().item<std::int64_t>(); };
  return {count(n_views == 0), count(n_views == 1), count(is_close), count(is_large)};
}

}  // namespace b3dgs
