#include "app/export/scene_views.h"

#include <cmath>

#include "core/check.h"
#include "model/raster_input.h"

namespace b3dgs {
namespace {

/// An axis of the camera in world coordinates: 0 right, 1 down.
torch::Tensor axis_tensor(const Camera& camera, std::size_t axis) {
  const double* const row = &camera.cam_from_world.rotation[3 * axis];
  return torch::tensor({row[0], row[1], row[2]}, torch::kFloat64);
}

}  // namespace

std::vector<double> blend_weight_sums(const LoadedModel& model, const std::vector<View>& views,
                                      const torch::Device& device, StatusLine& status) {
  const torch::NoGradGuard no_grad;
  ModelRenderer renderer(model, device);
  const torch::TensorOptions options = torch::TensorOptions().dtype(torch::kFloat32).device(device);
  const auto zeros = [&] { return torch::zeros({model.splats.size()}, options); };
  torch::Tensor sums = torch::zeros({model.splats.size()}, options.dtype(torch::kFloat64));
  const ProgressFn progress = show_loading(status);
  for (std::size_t i = 0; i < views.size(); ++i) {
    const RenderedView rendered = renderer.render(to_camera_view(views[i].camera));
    const GaussianScores scores{zeros(), zeros(), zeros(), zeros()};
    renderer.rasterizer.score(torch::zeros_like(rendered.alpha), scores);
    sums += scores.weight_sum;
    progress("contributions of Gaussians", i + 1, views.size());
  }
  status.clear();
  const torch::Tensor host = sums.to(torch::kCPU).contiguous();
  return {host.data_ptr<double>(), host.data_ptr<double>() + host.numel()};
}

std::array<double, 3> up_direction(const std::vector<View>& views) {
  if (views.empty()) input_error("--up needs cameras to know which way is up; name a scene with -s");
  constexpr double kMinAgreement = 0.3;  // mean of unit vectors: 1 if all are equal
  constexpr double kMinSpread = 0.05;    // share of the horizontal axes' second direction
  torch::Tensor mean_up = torch::zeros({3}, torch::kFloat64), spread = torch::zeros({3, 3}, torch::kFloat64);
  for (const View& view : views) {
    const torch::Tensor right = axis_tensor(view.camera, 0);
    mean_up -= axis_tensor(view.camera, 1);
    spread += torch::outer(right, right);
  }
  const auto n = static_cast<double>(views.size());
  const double agreement = mean_up.norm().item<double>() / n;
  if (agreement < kMinAgreement) {
    input_error("--up: the cameras do not agree which way is up (the mean of their upward axes has length ", agreement,
                ", expected at least ", kMinAgreement, ")");
  }
  const auto [values, vectors] = torch::linalg_eigh(spread / n);  // ascending
  torch::Tensor up = mean_up / mean_up.norm();
  if (values[1].item<double>() > kMinSpread) {
    const torch::Tensor across = vectors.select(1, 0);
    const double along = across.dot(up).item<double>();
    constexpr double kMinAlong = 0.7;  // cos 45 degrees: else the cameras are rolled
    if (std::abs(along) > kMinAlong) up = along > 0 ? across : -across;
  }
  return {up[0].item<double>(), up[1].item<double>(), up[2].item<double>()};
}

}  // namespace b3dgs
