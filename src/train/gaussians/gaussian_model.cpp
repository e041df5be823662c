#include "train/gaussians/gaussian_model.h"

#include <algorithm>
#include <cmath>

#include "core/check.h"
#include "model/neighbors.h"
#include "raster/math/opacity.h"
#include "raster/math/sh.h"

namespace b3dgs {
namespace {

torch::Tensor to_tensor(const std::vector<float>& values, std::vector<std::int64_t> sizes) {
  torch::Tensor tensor = torch::empty(sizes, torch::kFloat32);
  B3DGS_CHECK(tensor.numel() == static_cast<std::int64_t>(values.size()), values.size(),
              " values for a tensor of shape ", tensor.sizes());
  std::copy(values.begin(), values.end(), tensor.data_ptr<float>());
  return tensor;
}

}  // namespace

SplatCloud splats_from_points(const PointCloud& points, int sh_degree, double opacity, double scale) {
  const auto n = static_cast<std::size_t>(points.size());
  const std::vector<float> distances = mean_squared_neighbor_distances(points.positions);
  const double log_scale = std::log(scale);
  SplatCloud cloud;
  cloud.sh_degree = sh_degree;
  cloud.means = points.positions;
  cloud.quats.assign(4 * n, 0.0f);
  cloud.logit_opacities.assign(n, logit(opacity));
  cloud.shN.assign(3 * n * static_cast<std::size_t>(sh_coefficient_count(sh_degree) - 1), 0.0f);
  cloud.log_scales.reserve(3 * n);
  cloud.sh0.reserve(3 * n);
  for (std::size_t i = 0; i < n; ++i) {
    cloud.quats[4 * i] = 1.0f;
    for (int axis = 0; axis < 3; ++axis) {
      cloud.log_scales.push_back(static_cast<float>(0.5 * std::log(static_cast<double>(distances[i])) + log_scale));
    }
    for (std::size_t channel = 0; channel < 3; ++channel) {
      cloud.sh0.push_back(static_cast<float>((points.colors[3 * i + channel] / 255.0 - 0.5) / kSh0));
    }
  }
  return cloud;
}

GaussianTensors to_tensors(const SplatCloud& cloud, int sh_degree, torch::Device device) {
  const std::int64_t n = cloud.size();
  const std::int64_t own = sh_coefficient_count(cloud.sh_degree) - 1, wanted = sh_coefficient_count(sh_degree) - 1;
  GaussianTensors gaussians;
  gaussians.means = to_tensor(cloud.means, {n, 3}).to(device);
  gaussians.log_scales = to_tensor(cloud.log_scales, {n, 3}).to(device);
  gaussians.quats = to_tensor(cloud.quats, {n, 4}).to(device);
  gaussians.logit_opacities = to_tensor(cloud.logit_opacities, {n}).to(device);
  gaussians.sh0 = to_tensor(cloud.sh0, {n, 1, 3}).to(device);
  const torch::Tensor shN = to_tensor(cloud.shN, {n, own, 3});
  torch::Tensor resized = torch::zeros({n, wanted, 3}, torch::kFloat32);
  const std::int64_t common = std::min(own, wanted);
  resized.slice(1, 0, common).copy_(shN.slice(1, 0, common));
  gaussians.shN = resized.to(device);
  return gaussians;
}

SplatCloud initial_splats(const TrainConfig& config, const Scene& scene) {
  PointCloud points;
  std::string place = scene.source_path + ": the COLMAP model", left_out;
  if (config.init_ply.empty()) {
    points = scene.points;
  } else if (holds_splats(config.init_ply)) {
    SplatCloud cloud = read_splats(config.init_ply);
    if (cloud.size() == 0) input_error(config.init_ply, ": no Gaussians to start from");
    change_frame(scene.frame, cloud);
    return cloud;
  } else {
    const WorldPoints read = read_point_ply(config.init_ply);
    points = in_frame(scene.frame, read);
    left_out = read.left_out;
    place = config.init_ply;
  }
  if (points.size() == 0) {
    input_error(
        place,
        " has no 3D points, and none were found in the photographs; pass some with --init_ply FILE, or triangulate "
        "the scene again");
  }
  SplatCloud cloud = splats_from_points(points, 0, config.init_opacity, config.init_scale);
  cloud.frame = scene.frame;
  if (!left_out.empty()) cloud.notes.push_back(left_out);
  return cloud;
}

namespace {

constexpr double kSeenWeight = 1.0 / 255, kCloseShare = 0.1, kLargeShare = 0.3;
constexpr std::int64_t kGaussianColumn = 7;   // column of ViewSplats::splats
constexpr std::int64_t kMaxWeightColumn = 4;  // column of Rasterizer::score_splats()

/// Returns the median depth of the pixels with alpha over 0.5 in world units, or 0 if there are none.
torch::Tensor median_depth(const RenderedView& rendered) {
  const torch::Tensor depths = (rendered.depth / rendered.alpha).masked_select(rendered.alpha > 0.5);
  return depths.numel() > 0 ? depths.median() : torch::full({}, 0.0, depths.options());
}

}  // namespace

Floaters find_floaters(Rasterizer& rasterizer, const GaussianTensors& gaussians, const std::vector<CameraView>& views,
                       const RenderSettings& settings) {
  RenderSettings forward_only = settings;
  forward_only.keep_for_backward = false;
  const torch::TensorOptions floats = gaussians.means.options();
  torch::Tensor n_views = torch::zeros({gaussians.size()}, floats.dtype(torch::kInt32));
  torch::Tensor is_close = torch::zeros({gaussians.size()}, floats.dtype(torch::kBool));
  torch::Tensor is_large = torch::zeros_like(is_close);
  for (const CameraView& view : views) {
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
  return {n_views == 0, n_views == 1, is_close, is_large};
}

FloaterCount count_floaters(Rasterizer& rasterizer, const GaussianTensors& gaussians,
                            const std::vector<CameraView>& views, const RenderSettings& settings) {
  const Floaters found = find_floaters(rasterizer, gaussians, views, settings);
  const auto count = [](const torch::Tensor& rows) { return rows.sum().item<std::int64_t>(); };
  return {count(found.unseen), count(found.one_view), count(found.close), count(found.large)};
}

}  // namespace b3dgs
