#include "raster/torch/fused_step.h"

#include "raster/torch/rasterizer_impl.h"

namespace b3dgs {

RenderedView FusedStep::forward(const GaussianTensors& gaussians, const PinholeView& view,
                                const RenderSettings& settings, cuda::ColorPass* colors) {
  return rasterizer_.impl_->forward(gaussians, view, settings, colors);
}

ViewSplats FusedStep::project(const GaussianTensors& gaussians, const PinholeView& view, const RenderSettings& settings,
                              cuda::ColorPass* colors) {
  return rasterizer_.impl_->project(gaussians, view, settings, colors);
}

std::vector<ViewSplats> FusedStep::project_views(const GaussianTensors& gaussians,
                                                 const std::vector<PinholeView>& views,
                                                 const std::vector<RenderSettings>& settings, cuda::ColorPass* colors) {
  return rasterizer_.impl_->project_views(gaussians, views, settings, colors);
}

ViewStatistics FusedStep::backward_blend(const GaussianTensors& gaussians, const RenderedViewGrad& grad,
                                         cuda::ProjectBackwardCudaArgs& rest) {
  Rasterizer::Impl& impl = *rasterizer_.impl_;
#if B3DGS_TORCH_CUDA
  if (impl.cuda != nullptr) {
    const GaussianArrays arrays = arrays_of(gaussians, impl.device);
    rest = impl.cuda->backward_blend(arrays, impl.image_grad(grad), torch_launch_context());
    const ViewStatistics& statistics = impl.make_statistics(arrays.n_gaussians);
    rest.grad.means2d = statistics.means2d_grad.data_ptr<float>();
    impl.add_camera_gradient();
    return statistics;
  }
#endif
  (void)gaussians, (void)grad, (void)rest;
  throw LogicError(detail::concat("backward_blend() on ", impl.device.str(), " needs a forward() on a GPU before"));
}

}  // namespace b3dgs
