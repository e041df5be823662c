// From tensors to argument structs: checks, memory, device. Nothing below this file knows torch.

#include "raster/torch/rasterizer.h"

#include "core/check.h"
#include "raster/cpu/rasterize_cpu.h"
#include "raster/torch/tensor_check.h"
#include "raster/torch/tensor_storage.h"

// Set by the build where both nvcc and a LibTorch with CUDA are there.
#if B3DGS_TORCH_CUDA
#include "raster/cuda/rasterize_cuda.h"
#include "raster/torch/torch_launch.h"
#endif

namespace b3dgs {
namespace {

GaussianArrays arrays_of(const GaussianTensors& g, torch::Device device) {
  TensorCheck check(device);
  check.dims("means", g.means, {"N", 3});
  check.dims("log_scales", g.log_scales, {"N", 3});
  check.dims("quats", g.quats, {"N", 4});
  check.dims("logit_opacities", g.logit_opacities, {"N"});
  check.dims("sh0", g.sh0, {"N", 1, 3});
  check.dims("shN", g.shN, {"N", "K-1", 3});
  return {g.means.size(0),           sh_degree_max_of(g),
          g.means.data_ptr<float>(), g.log_scales.data_ptr<float>(),
          g.quats.data_ptr<float>(), g.logit_opacities.data_ptr<float>(),
          g.sh0.data_ptr<float>(),   g.shN.data_ptr<float>()};
}

/// Keeps `tensor` if it can be written to as an array of this shape and kind, else replaces it.
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

const float* data_or_null(const torch::Tensor& tensor) {
  return tensor.defined() ? tensor.data_ptr<float>() : nullptr;
}

}  // namespace

struct Rasterizer::Impl {
  explicit Impl(torch::Device where) : device(where) {}

  torch::Device device;
  cpu::Rasterizer cpu;
#if B3DGS_TORCH_CUDA
  std::unique_ptr<cuda::Rasterizer> cuda;  // made on first use: a CPU run never touches the driver
#endif
  RenderedView rendered;
  torch::Tensor color_room, depth_room, alpha_room, means2d_room;
  ViewStatistics statistics;

  void forward(const GaussianArrays& arrays, const PinholeView& view, const RenderSettings& settings,
               const ImageArrays& out) {
    if (device.is_cpu()) {
      B3DGS_CHECK(settings.color_pass == nullptr, "a color_pass on the CPU");
      return cpu.forward(arrays, view, settings, out);
    }
#if B3DGS_TORCH_CUDA
    if (cuda == nullptr) cuda = std::make_unique<cuda::Rasterizer>();
    cuda->forward(arrays, view, settings, out, torch_launch_context());
#endif
  }

  void backward(const GaussianArrays& arrays, const ImageGradArrays& grad, const GaussianGradArrays& out) {
    if (device.is_cpu()) return cpu.backward(arrays, grad, out);
#if B3DGS_TORCH_CUDA
    cuda->backward(arrays, grad, out, torch_launch_context());
#endif
  }

  void reblend(ForwardKernel kernel) {
    if (device.is_cpu()) return cpu.reblend(kernel);
#if B3DGS_TORCH_CUDA
    B3DGS_CHECK(cuda != nullptr, "reblend before any forward");
    cuda->reblend(kernel, torch_launch_context());
#endif
  }

  /// Into tensors on the device.
  void count_load(torch::Tensor& processed, torch::Tensor& contributing) const {
    std::int32_t* const out[]{processed.data_ptr<std::int32_t>(), contributing.data_ptr<std::int32_t>()};
    if (device.is_cpu()) return cpu.count_load(out[0], out[1]);
#if B3DGS_TORCH_CUDA
    cuda->count_load(out[0], out[1], torch_launch_context());
#endif
  }

  /// Offsets of the tiles' lists, and how many tiles there are.
  std::pair<const std::int64_t*, std::int64_t> tile_offsets() const {
#if B3DGS_TORCH_CUDA
    if (cuda != nullptr) return {cuda->bins().tile_offsets, cuda->grid().n_tiles()};
#endif
    return {cpu.bins().tile_offsets, cpu.grid().n_tiles()};
  }

  const std::int32_t* radii() const {
#if B3DGS_TORCH_CUDA
    if (cuda != nullptr) return cuda->radii();
#endif
    return cpu.radii();
  }

  /// Of the last forward(), once checked.
  ImageGradArrays image_grad(const RenderedViewGrad& grad) const {
    B3DGS_CHECK(rendered.color.defined(), "backward before any forward");
    TensorCheck check(device);
    check.bind("H", rendered.color.size(0));
    check.bind("W", rendered.color.size(1));
    if (grad.color.defined()) check.dims("grad.color", grad.color, {"H", "W", 3});
    if (grad.depth.defined()) check.dims("grad.depth", grad.depth, {"H", "W"});
    if (grad.alpha.defined()) check.dims("grad.alpha", grad.alpha, {"H", "W"});
    return {data_or_null(grad.color), data_or_null(grad.depth), data_or_null(grad.alpha)};
  }

  /// With room for the gradients by the centres. The radii are a view of the rasterizer's own array: valid until the
  /// next forward.
  const ViewStatistics& make_statistics(std::int64_t n_gaussians) {
    const torch::TensorOptions options = rendered.color.options();
    place_tensor(statistics.means2d_grad, means2d_room, {n_gaussians, 2}, options, /*spare_part=*/4);
    statistics.radii =
        torch::from_blob(const_cast<std::int32_t*>(radii()), {n_gaussians}, options.dtype(torch::kInt32));
    return statistics;
  }
};

Rasterizer::Rasterizer(torch::Device device) : impl_(std::make_unique<Impl>(device)) {
  if (device.is_cpu()) return;
  if (!kTorchHasCuda) {
    input_error("this build renders on the CPU only (its LibTorch has no CUDA), found device ", device.str(),
                "; use --device cpu");
  }
}
Rasterizer::~Rasterizer() = default;
Rasterizer::Rasterizer(Rasterizer&&) noexcept = default;
Rasterizer& Rasterizer::operator=(Rasterizer&&) noexcept = default;

RenderedView Rasterizer::forward(const GaussianTensors& gaussians, const PinholeView& view,
                                 const RenderSettings& settings) {
  const GaussianArrays arrays = arrays_of(gaussians, impl_->device);
  RenderedView& out = impl_->rendered;
  const auto options = gaussians.means.options();
  place_tensor(out.color, impl_->color_room, {view.height, view.width, 3}, options);
  place_tensor(out.depth, impl_->depth_room, {view.height, view.width}, options);
  place_tensor(out.alpha, impl_->alpha_room, {view.height, view.width}, options);
  impl_->forward(arrays, view, settings,
                 {out.color.data_ptr<float>(), out.depth.data_ptr<float>(), out.alpha.data_ptr<float>()});
  return out;
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
  return statistics;
}

ViewStatistics Rasterizer::backward_blend(const GaussianTensors& gaussians, const RenderedViewGrad& grad,
                                          cuda::ProjectBackwardCudaArgs& rest) {
#if B3DGS_TORCH_CUDA
  if (impl_->cuda != nullptr) {
    const GaussianArrays arrays = arrays_of(gaussians, impl_->device);
    rest = impl_->cuda->backward_blend(arrays, impl_->image_grad(grad), torch_launch_context());
    const ViewStatistics& statistics = impl_->make_statistics(arrays.n_gaussians);
    rest.grad.means2d = statistics.means2d_grad.data_ptr<float>();
    return statistics;
  }
#endif
  (void)gaussians, (void)grad, (void)rest;
  throw LogicError(detail::concat("backward_blend on ", impl_->device.str(), "; it needs a forward on a GPU"));
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
    constexpr std::int64_t kFloats = 12, kThatCount = 10;
    return torch::from_blob(const_cast<float*>(own.splat_grads()), {own.n_splats(), kFloats},
                            impl_->rendered.color.options())
        .narrow(1, 0, kThatCount);
  }
#endif
  (void)grad;
  throw LogicError(detail::concat("reblend_backward with ", backward_kernel_name(kernel), " on ", impl_->device.str(),
                                  "; there is one backward kernel on the CPU"));
}

ViewSize Rasterizer::view_size() const {
#if B3DGS_TORCH_CUDA
  if (impl_->cuda != nullptr) return {impl_->cuda->n_splats(), impl_->cuda->bins().n_isects};
#endif
  return {impl_->cpu.n_splats(), impl_->cpu.bins().n_isects};
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
  impl_->color_room = impl_->depth_room = impl_->alpha_room = impl_->means2d_room = torch::Tensor();
  impl_->rendered = RenderedView{};
  impl_->statistics = ViewStatistics{};
}

ViewLoad Rasterizer::count_load() const {
  B3DGS_CHECK(impl_->rendered.alpha.defined(), "count_load before any forward");
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
