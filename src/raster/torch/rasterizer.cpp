#include "raster/torch/rasterizer.h"

#include "raster/torch/rasterizer_impl.h"

namespace b3dgs {
namespace {

/// Replaces `tensor` unless it is contiguous and has this shape, type and device.
void ensure(torch::Tensor& tensor, torch::IntArrayRef sizes, const torch::TensorOptions& options) {
  const bool fits = tensor.defined() && tensor.sizes() == sizes && tensor.is_contiguous() &&
                    tensor.dtype() == options.dtype() && tensor.device() == options.device();
  if (!fits) tensor = torch::empty(sizes, options);
}

#if B3DGS_TORCH_CUDA
constexpr bool kTorchHasCuda = true;
#else
constexpr bool kTorchHasCuda = false;
#endif

}  // namespace

Rasterizer::Rasterizer(torch::Device device) : impl_(std::make_unique<Impl>(device)) {
  if (device.is_cpu()) return;
  if (!kTorchHasCuda) {
    input_error("device ", device.str(), " is not supported: this build's LibTorch has no CUDA; use --device cpu");
  }
}
Rasterizer::~Rasterizer() = default;
Rasterizer::Rasterizer(Rasterizer&&) noexcept = default;
Rasterizer& Rasterizer::operator=(Rasterizer&&) noexcept = default;

RenderedView Rasterizer::forward(const GaussianTensors& gaussians, const PinholeView& view,
                                 const RenderSettings& settings) {
  return impl_->forward(gaussians, view, settings, nullptr);
}

ViewStatistics Rasterizer::backward(const GaussianTensors& gaussians, const RenderedViewGrad& grad,
                                    GaussianTensors& grads) {
  const GaussianArrays arrays = arrays_of(gaussians, impl_->device);
  const ImageGradArrays image = impl_->image_grad(grad);
  const auto options = gaussians.means.options();
  const auto parameters = gaussians.all();
  const auto gradients = grads.all();
  for (std::size_t i = 0; i < parameters.size(); ++i) ensure(*gradients[i], parameters[i]->sizes(), options);
  const ViewStatistics& statistics = impl_->make_statistics(arrays.n_gaussians);
  impl_->backward(arrays, image,
                  {grads.means.data_ptr<float>(), grads.log_scales.data_ptr<float>(), grads.quats.data_ptr<float>(),
                   grads.logit_opacities.data_ptr<float>(), grads.sh0.data_ptr<float>(), grads.shN.data_ptr<float>(),
                   statistics.means2d_grad.data_ptr<float>()});
  impl_->add_camera_gradient();
  return statistics;
}

ViewStatistics Rasterizer::backward_to_splats(const GaussianTensors& gaussians, const RenderedViewGrad& grad,
                                              const KeptSplats& out) {
  const GaussianArrays arrays = arrays_of(gaussians, impl_->device);
  const ImageGradArrays image = impl_->image_grad(grad);
  TensorCheck check(impl_->device);
  check.bind("N", arrays.n_gaussians);
  const ViewStatistics& statistics = impl_->make_statistics(arrays.n_gaussians);
  impl_->backward_to_splats(arrays, image, arrays_of(out, view_size().n_splats, check, statistics.means2d_grad));
  impl_->add_camera_gradient();
  return statistics;
}

RenderedView Rasterizer::reblend(ForwardKernel kernel) {
  impl_->reblend(kernel);
  return impl_->rendered;
}

torch::Tensor Rasterizer::reblend_backward(BackwardKernel kernel, const RenderedViewGrad& grad) {
#if B3DGS_TORCH_CUDA
  if (impl_->cuda != nullptr) {
    cuda::Rasterizer& own = *impl_->cuda;
    own.reblend_backward(kernel, impl_->image_grad(grad), torch_launch_context());
    constexpr std::int64_t kFloats = 12, kUsed = 10;  // SplatGradSum, SplatGrad
    return torch::from_blob(const_cast<float*>(own.splat_grads()), {own.n_splats(), kFloats},
                            impl_->rendered.color.options())
        .narrow(1, 0, kUsed);
  }
#endif
  (void)grad;
  throw LogicError(detail::concat("reblend_backward() with ", backward_kernel_name(kernel), " on ", impl_->device.str(),
                                  ": needs a forward() on a GPU before"));
}

ViewSize Rasterizer::view_size() const {
#if B3DGS_TORCH_CUDA
  if (impl_->cuda != nullptr) return {impl_->cuda->n_splats(), impl_->cuda->bins().n_pairs};
#endif
  return {impl_->cpu.n_splats(), impl_->cpu.bins().n_pairs};
}

std::int64_t Rasterizer::memory_bytes() const {
#if B3DGS_TORCH_CUDA
  if (impl_->cuda != nullptr) return impl_->cuda->memory_bytes();
#endif
  return 0;
}

void Rasterizer::release_memory() {
#if B3DGS_TORCH_CUDA
  if (impl_->cuda != nullptr) impl_->cuda->release_memory();
#endif
  impl_->color_storage = impl_->depth_storage = impl_->alpha_storage = impl_->means2d_storage = torch::Tensor();
  impl_->rendered = RenderedView{};
  impl_->statistics = ViewStatistics{};
}

void Rasterizer::score(const torch::Tensor& error, const GaussianScores& scores) {
  B3DGS_CHECK(impl_->n_gaussians >= 0 && impl_->rendered.alpha.defined(), "score() before any forward()");
  impl_->check_error(error);
  TensorCheck check(impl_->device);
  check.bind("N", impl_->n_gaussians);
  impl_->score(error.data_ptr<float>(), arrays_of(scores, check));
}

torch::Tensor Rasterizer::row_entries() const {
  B3DGS_CHECK(impl_->rendered.alpha.defined(), "row_entries() before any forward()");
  const torch::TensorOptions options = impl_->rendered.alpha.options().dtype(torch::kInt32);
  const torch::Tensor last =
      torch::from_blob(const_cast<std::int32_t*>(impl_->last_ids()), impl_->rendered.alpha.sizes(), options);
  return last.sum(/*dim=*/1, /*keepdim=*/false, torch::kInt64).add_(last.size(1));
}

ViewLoad Rasterizer::count_load() const {
  B3DGS_CHECK(impl_->rendered.alpha.defined(), "count_load() before any forward()");
  const auto counts = impl_->rendered.alpha.options().dtype(torch::kInt32);
  ViewLoad load;
  load.processed = torch::empty(impl_->rendered.alpha.sizes(), counts);
  load.contributing = torch::empty_like(load.processed);
  impl_->count_load(load.processed, load.contributing);
  const auto [offsets, n_tiles] = impl_->tile_offsets();
  const torch::Tensor ends =
      torch::from_blob(const_cast<std::int64_t*>(offsets), {n_tiles + 1}, counts.dtype(torch::kInt64)).cpu();
  load.tile_lists = ends.slice(0, 1) - ends.slice(0, 0, -1);
  load.processed = load.processed.cpu();
  load.contributing = load.contributing.cpu();
  return load;
}

}  // namespace b3dgs
