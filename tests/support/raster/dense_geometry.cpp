#include "support/raster/dense_geometry.h"

#include <cmath>

#include "core/vec.h"

namespace b3dgs::test {
namespace {

constexpr double kHalf = 0.5, kLow = 0.4, kHigh = 0.6, kReach = 0.2, kSpread = 0.01;

/// Planes of M Gaussians.
struct DensePlanes {
  torch::Tensor depth;      // [M]
  torch::Tensor slope;      // [M, 2] of 1 / depth, per px
  torch::Tensor normal;     // [M, 3]
  torch::Tensor thickness;  // [M]
};

DensePlanes dense_planes(const GaussianTensors& leaves, const CameraView& view, const RenderSettings& settings,
                         const torch::Tensor& rows) {
  DensePlanes planes;
  const DenseCenters centers = dense_centers(leaves.means.index_select(0, rows), view);
  planes.depth = centers.depth;
  torch::Tensor variances = (2 * leaves.log_scales.index_select(0, rows)).exp();
  if (settings.antialiasing && leaves.filters.defined()) {
    variances = variances + leaves.filters.index_select(0, rows).square().unsqueeze(1);
  }
  const torch::Tensor axes = torch::matmul(centers.rotation, dense_rotations(leaves.quats.index_select(0, rows)));
  const torch::Tensor inverse =
      torch::matmul(torch::matmul(axes, torch::diag_embed(1 / variances)), axes.transpose(1, 2));
  const torch::Tensor ray = centers.points / centers.depth.unsqueeze(1);
  const torch::Tensor across = torch::matmul(inverse, ray.unsqueeze(2)).squeeze(2);
  const torch::Tensor along = (across * ray).sum(1);
  const torch::Tensor slope = across / (along * planes.depth).unsqueeze(1);
  planes.normal = -across / across.norm(2, 1, true);
  planes.thickness = (1 / (along * planes.depth.square())).clamp_max(1.0);
  // Columns 0 and 1 of the inverse: the motion of the point for a px, at constant depth.
  const torch::Tensor motion =
      torch::inverse(torch::cat({centers.jacobian, centers.deeper.unsqueeze(1)}, 1)).slice(2, 0, 2);
  planes.slope = torch::matmul(slope.unsqueeze(1), motion).squeeze(1) / planes.depth.unsqueeze(1);
  return planes;
}

}  // namespace

DenseSurface dense_surface(const GaussianTensors& leaves, const CameraView& view, const RenderSettings& settings,
                           const DenseView& rendered, DepthKind kind) {
  const torch::NoGradGuard no_grad;
  const std::int64_t width = view.width, height = view.height;
  const torch::Tensor weights = rendered.weights;
  const torch::Tensor after = 1 - weights.cumsum(1), before = after + weights;
  const torch::Tensor remaining = 1 - weights.sum(1);
  const auto is_near = [](const torch::Tensor& value, double threshold) { return (value - threshold).abs() < 1e-5; };
  torch::Tensor doubtful = rendered.near_decision.flatten() | is_near(remaining, kHalf);

  torch::Tensor share = weights;
  if (kind == DepthKind::kSurface) share = (before.clamp_max(kHigh) - after.clamp_min(kLow)).clamp_min(0.0);
  if (kind == DepthKind::kMedian) {
    share = ((before >= kHalf) & (after < kHalf)).to(torch::kFloat64);
    doubtful = doubtful | is_near(after, kHalf).any(1);
  }
  const DensePlanes planes = dense_planes(leaves, view, settings, rendered.rows);
  const torch::Tensor means = rendered.means2d.index_select(0, rendered.rows);
  torch::Tensor dx = torch::arange(width, torch::kFloat64).repeat({height}).unsqueeze(1) + 0.5 - means.select(1, 0);
  if (view.lens.kind == LensKind::kEquirectangular) dx = dx - width * (dx / width).round();  // nearest copy
  const torch::Tensor dy =
      torch::arange(height, torch::kFloat64).repeat_interleave(width).unsqueeze(1) + 0.5 - means.select(1, 1);

  torch::Tensor value = planes.depth.expand_as(share);
  if (kind != DepthKind::kMean) {
    const torch::Tensor tilted = 1 / planes.depth + planes.slope.select(1, 0) * dx + planes.slope.select(1, 1) * dy;
    const torch::Tensor relative = tilted * planes.depth;
    value = torch::where((relative >= 1 / (1 + kReach)) & (relative <= 1 / (1 - kReach)), tilted,
                         (1 / planes.depth).expand_as(tilted));
    const torch::Tensor at_limit = (is_near(relative, 1 / (1 + kReach)) | is_near(relative, 1 / (1 - kReach)));
    doubtful = doubtful | (at_limit & (share > 0)).any(1);
  }
  const torch::Tensor total = share.sum(1), mean = (share * value).sum(1) / total;
  const torch::Tensor scatter = (share * (value - mean.unsqueeze(1)).square()).sum(1) / total / mean.square();
  const torch::Tensor variance = scatter + torch::mv(share, planes.thickness) / total;
  const torch::Tensor normal = torch::matmul(weights, planes.normal);

  const torch::Tensor is_empty = remaining >= kHalf;
  const auto image = [&](const torch::Tensor& pixels) {
    return pixels.masked_fill(is_empty, 0.0).view({height, width});
  };
  return {image(kind == DepthKind::kMean ? mean : 1 / mean),
          (normal / normal.norm(2, 1, true)).masked_fill(is_empty.unsqueeze(1), 0.0).view({height, width, 3}),
          image(1 / (1 + variance / (kSpread * kSpread))), doubtful.view({height, width})};
}

}  // namespace b3dgs::test
