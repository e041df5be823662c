// Views that are split at the splats: what ranks need that draw the splats of each other's Gaussians.
#include <vector>

#include "raster/torch/rasterizer_impl.h"

namespace b3dgs {

std::vector<ViewSplats> Rasterizer::Impl::project_views(const GaussianTensors& gaussians,
                                                        const std::vector<PinholeView>& views,
                                                        const std::vector<RenderSettings>& settings,
                                                        cuda::ColorPass* colors) {
  B3DGS_CHECK(settings.size() == views.size(), "settings for ", settings.size(), " views of ", views.size());
  std::vector<ViewSplats> all;
#if B3DGS_TORCH_CUDA
  if (!device.is_cpu() && seen_share > 0) {
    const GaussianArrays arrays = arrays_of(gaussians, device);
    n_gaussians = n_rows = -1;
    const auto n = static_cast<double>(arrays.n_gaussians);
    const std::int64_t room = std::min(arrays.n_gaussians, static_cast<std::int64_t>(kSeenMargin * seen_share * n) + 1);
    for (std::size_t v = 0; v < views.size(); ++v) {
      all.push_back(allocate_splats(gaussians, room));
      on_gpu().queue_projection(v, arrays, views[v], settings[v], row_arrays_of(all[v]), room, torch_launch_context(),
                                colors);
    }
    const std::vector<std::int64_t> n_splats = on_gpu().wait_for_projections();
    for (std::size_t v = 0; v < views.size(); ++v) {
      note_seen(n_splats[v], arrays.n_gaussians);
      all[v] =
          n_splats[v] <= room ? first_rows(all[v], n_splats[v]) : project(gaussians, views[v], settings[v], colors);
    }
    return all;
  }
#endif
  for (std::size_t v = 0; v < views.size(); ++v) {
    all.push_back(project(gaussians, views[v], settings[v], colors));
    note_seen(all[v].size(), gaussians.size());
  }
  return all;
}

ViewSplats Rasterizer::project(const GaussianTensors& gaussians, const PinholeView& view,
                               const RenderSettings& settings) {
  return impl_->project(gaussians, view, settings, nullptr);
}

std::vector<ViewSplats> Rasterizer::project_views(const GaussianTensors& gaussians,
                                                  const std::vector<PinholeView>& views,
                                                  const std::vector<RenderSettings>& settings) {
  return impl_->project_views(gaussians, views, settings, nullptr);
}

RenderedView Rasterizer::forward_splats(const ViewSplats& splats, const PinholeView& view,
                                        const RenderSettings& settings) {
  return impl_->forward_splats(splats, view, settings);
}

torch::Tensor Rasterizer::backward_splats(const RenderedViewGrad& grad) {
  B3DGS_CHECK(impl_->n_rows >= 0, "backward_splats() before any forward_splats()");
  const ImageGradArrays image = impl_->image_grad(grad);
  constexpr std::int64_t kWords = sizeof(SplatGradSum) / sizeof(float);
  const torch::Tensor sums = torch::empty({impl_->n_rows, kWords}, impl_->rendered.color.options());
  impl_->backward_splats(image, rows_at<SplatGradSum>("sums", sums));
  return sums;
}

torch::Tensor Rasterizer::order_of_splats() const {
  B3DGS_CHECK(impl_->n_rows >= 0, "order_of_splats() before any forward_splats()");
  const torch::TensorOptions options = impl_->rendered.color.options();
#if B3DGS_TORCH_CUDA
  if (impl_->cuda != nullptr) {
    B3DGS_CHECK(impl_->cuda->n_splats() == impl_->n_rows, impl_->cuda->n_splats(), " of ", impl_->n_rows,
                " splats are drawn");
    return torch::from_blob(const_cast<std::int32_t*>(impl_->cuda->rank_of_row()), {impl_->n_rows},
                            options.dtype(torch::kInt32))
        .to(torch::kInt64);
  }
#endif
  return torch::arange(impl_->n_rows, options.dtype(torch::kInt64));
}

torch::Tensor Rasterizer::score_splats(const torch::Tensor& error) {
  B3DGS_CHECK(impl_->n_rows >= 0, "score_splats() before any forward_splats()");
  impl_->check_error(error);
  constexpr std::int64_t kWords = sizeof(ScoreSums) / sizeof(std::int32_t);
  const torch::Tensor sums =
      torch::empty({impl_->n_rows, kWords}, impl_->rendered.color.options().dtype(torch::kInt32));
  impl_->score_splats(error.data_ptr<float>(), rows_at<ScoreSums>("sums", sums));
  return sums;
}

}  // namespace b3dgs
