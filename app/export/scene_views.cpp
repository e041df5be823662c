#include "app/export/scene_views.h"

#include "model/raster_input.h"

namespace b3dgs {
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

}  // namespace b3dgs
