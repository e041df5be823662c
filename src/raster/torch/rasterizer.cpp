// From tensors to the arrays of RasterizerBackend: checks tensors, allocates outputs, selects the device.
#include "raster/torch/rasterizer.h"

#include <algorithm>
#include <memory>
#include <vector>

#include "core/check.h"
#include "raster/cpu/passes.h"
#include "raster/torch/tensors.h"
#include "raster/torch/torch_cuda.h"

#if B3DGS_TORCH_CUDA
#include "raster/cuda/passes.h"
#endif

namespace b3dgs {
namespace {

std::unique_ptr<RasterizerBackend> make_backend(torch::Device device) {
#if B3DGS_TORCH_CUDA
  if (!device.is_cpu()) return cuda::make_rasterizer(torch_launch_context);
#endif
  (void)device;
  return cpu::make_rasterizer();
}

/// A tensor on memory of the backend.
template <class T>
torch::Tensor tensor_of(const T* data, torch::IntArrayRef sizes, const torch::TensorOptions& options,
                        torch::ScalarType type) {
  return torch::from_blob(const_cast<T*>(data), sizes, options.dtype(type));
}

ViewSplats allocate_splats(const GaussianTensors& gaussians, std::int64_t n) {
  constexpr std::int64_t kColumns = sizeof(Splat) / sizeof(float);
  const torch::TensorOptions floats = gaussians.means.options();
  return {torch::empty({n, kColumns}, floats), torch::empty({n, 2}, floats),
          torch::empty({n}, floats.dtype(torch::kInt32))};
}

SplatRowArrays row_arrays_of(const ViewSplats& splats) {
  return {rows_at<Splat>("splats", splats.splats), rows_at<Vec2f>("extents", splats.extents),
          splats.radii.data_ptr<std::int32_t>()};
}

}  // namespace

struct Rasterizer::Impl {
  explicit Impl(torch::Device where) : device(where) {}

  const torch::Device device;
  RenderedView rendered;
  torch::Tensor color_storage, depth_storage, alpha_storage, means2d_storage;
  ViewStatistics statistics;
  double seen_share = 0;  // largest share of the Gaussians that a view of project_views() has seen

  /// Made when it is first used, so that a GPU is not initialised before.
  RasterizerBackend& backend() {
    if (backend_ == nullptr) backend_ = make_backend(device);
    return *backend_;
  }
  void release_memory() {
    if (backend_ != nullptr) backend_->release_memory();
    color_storage = depth_storage = alpha_storage = means2d_storage = torch::Tensor();
    rendered = RenderedView{};
    statistics = ViewStatistics{};
  }

  /// Images for a view, whose rendering must follow.
  ImageArrays begin_view(const CameraView& view, const torch::TensorOptions& options) {
    backend().forget_view();
    place_tensor(rendered.color, color_storage, {view.height, view.width, 3}, options);
    place_tensor(rendered.depth, depth_storage, {view.height, view.width}, options);
    place_tensor(rendered.alpha, alpha_storage, {view.height, view.width}, options);
    return {rendered.color.data_ptr<float>(), rendered.depth.data_ptr<float>(), rendered.alpha.data_ptr<float>()};
  }

  /// A check of images of the last forward().
  TensorCheck image_check(const char* what) const {
    B3DGS_CHECK(rendered.color.defined(), what, " before any forward()");
    TensorCheck check(device);
    check.bind("H", rendered.color.size(0));
    check.bind("W", rendered.color.size(1));
    return check;
  }
  ImageGradArrays image_grad(const RenderedViewGrad& grad) const {
    TensorCheck check = image_check("backward()");
    if (grad.color.defined()) check.dims("grad.color", grad.color, {"H", "W", 3});
    if (grad.depth.defined()) check.dims("grad.depth", grad.depth, {"H", "W"});
    if (grad.alpha.defined()) check.dims("grad.alpha", grad.alpha, {"H", "W"});
    return {data_or_null(grad.color), data_or_null(grad.depth), data_or_null(grad.alpha)};
  }
  const float* error_image(const torch::Tensor& error) const {
    image_check("an error image").dims("error", error, {"H", "W"});
    return error.data_ptr<float>();
  }

  /// Statistics with allocated gradients, not yet written. `radii` refers to the backend's own array and is valid until
  /// the next forward().
  const ViewStatistics& make_statistics(std::int64_t n) {
    const torch::TensorOptions options = rendered.color.options();
    place_tensor(statistics.means2d_grad, means2d_storage, {n, 2}, options, /*spare_part=*/4);
    statistics.radii = tensor_of(backend().radii(), {n}, options, torch::kInt32);
    return statistics;
  }
  /// After the backward pass.
  const ViewStatistics& finish_statistics() {
    statistics.camera_grad = torch::Tensor();
    if (backend().view_state().has_camera_gradient) {
      statistics.camera_grad =
          tensor_of(backend().camera_gradient(), {kCameraGradients}, rendered.color.options(), torch::kFloat64);
    }
    return statistics;
  }

  void note_seen(std::int64_t n_seen, std::int64_t n) {
    if (n > 0) seen_share = std::max(seen_share, static_cast<double>(n_seen) / static_cast<double>(n));
  }

 private:
  std::unique_ptr<RasterizerBackend> backend_;
};

Rasterizer::Rasterizer(torch::Device device) : impl_(std::make_unique<Impl>(device)) {
  if (device.is_cpu() || kTorchHasCuda) return;
  input_error("device ", device.str(), " is not supported: this build's LibTorch has no CUDA; use --device cpu");
}
Rasterizer::~Rasterizer() = default;
Rasterizer::Rasterizer(Rasterizer&&) noexcept = default;
Rasterizer& Rasterizer::operator=(Rasterizer&&) noexcept = default;

RenderedView Rasterizer::forward(const GaussianTensors& gaussians, const CameraView& view,
                                 const RenderSettings& settings) {
  const GaussianArrays arrays = arrays_of(gaussians, impl_->device);
  impl_->backend().forward(arrays, view, settings, impl_->begin_view(view, gaussians.means.options()));
  return impl_->rendered;
}

ViewStatistics Rasterizer::backward(const GaussianTensors& gaussians, const RenderedViewGrad& grad,
                                    GaussianTensors& grads) {
  const GaussianArrays arrays = arrays_of(gaussians, impl_->device);
  const ImageGradArrays image = impl_->image_grad(grad);
  const ViewStatistics& statistics = impl_->make_statistics(arrays.n_gaussians);
  impl_->backend().backward(arrays, image, make_gradients(gaussians, grads, statistics.means2d_grad.data_ptr<float>()));
  return impl_->finish_statistics();
}

ViewStatistics Rasterizer::backward_blend(const GaussianTensors& gaussians, const RenderedViewGrad& grad,
                                          cuda::ProjectBackwardCudaArgs& rest) {
  const GaussianArrays arrays = arrays_of(gaussians, impl_->device);
  const ImageGradArrays image = impl_->image_grad(grad);
  const ViewStatistics& statistics = impl_->make_statistics(arrays.n_gaussians);
  impl_->backend().backward_blend(arrays, image, statistics.means2d_grad.data_ptr<float>(), rest);
  return impl_->finish_statistics();
}

ViewStatistics Rasterizer::backward_to_splats(const GaussianTensors& gaussians, const RenderedViewGrad& grad,
                                              const SplatRecordTensors& out) {
  const GaussianArrays arrays = arrays_of(gaussians, impl_->device);
  const ImageGradArrays image = impl_->image_grad(grad);
  TensorCheck check(impl_->device);
  check.bind("N", arrays.n_gaussians);
  const ViewStatistics& statistics = impl_->make_statistics(arrays.n_gaussians);
  impl_->backend().backward_to_splats(arrays, image,
                                      arrays_of(out, view_size().n_splats, check, statistics.means2d_grad));
  return impl_->finish_statistics();
}

ViewSplats Rasterizer::project(const GaussianTensors& gaussians, const CameraView& view,
                               const RenderSettings& settings) {
  const GaussianArrays arrays = arrays_of(gaussians, impl_->device);
  ViewSplats out;
  out.n_second = impl_->backend().project(arrays, view, settings, [&](std::int64_t n) {
    out = allocate_splats(gaussians, n);
    return row_arrays_of(out);
  });
  return out;
}

std::vector<ViewSplats> Rasterizer::project_views(const GaussianTensors& gaussians,
                                                  const std::vector<CameraView>& views,
                                                  const std::vector<RenderSettings>& settings) {
  B3DGS_CHECK(settings.size() == views.size(), "settings for ", settings.size(), " views of ", views.size());
  std::vector<ViewSplats> all;
  if (impl_->device.is_cpu() || impl_->seen_share == 0) {
    for (std::size_t v = 0; v < views.size(); ++v) {
      all.push_back(project(gaussians, views[v], settings[v]));
      impl_->note_seen(all[v].size(), gaussians.size());
    }
    return all;
  }
  const GaussianArrays arrays = arrays_of(gaussians, impl_->device);
  constexpr double kSeenMargin = 1.1;
  const auto n = static_cast<double>(arrays.n_gaussians);
  const std::int64_t capacity =
      std::min(arrays.n_gaussians, static_cast<std::int64_t>(kSeenMargin * impl_->seen_share * n) + 1);
  RasterizerBackend& backend = impl_->backend();
  for (std::size_t v = 0; v < views.size(); ++v) {
    all.push_back(allocate_splats(gaussians, capacity));
    backend.queue_projection(v, arrays, views[v], settings[v], row_arrays_of(all[v]), capacity);
  }
  const std::vector<SplatCounts> counts = backend.wait_for_projections();
  for (std::size_t v = 0; v < views.size(); ++v) {
    const auto [n_first, n_second] = counts[v];
    impl_->note_seen(n_first, arrays.n_gaussians);
    if (n_first > capacity) {
      all[v] = project(gaussians, views[v], settings[v]);
    } else {
      for (torch::Tensor* tensor : {&all[v].splats, &all[v].extents, &all[v].radii}) {
        *tensor = tensor->slice(0, 0, n_first);
      }
      all[v].n_second = n_second;
    }
  }
  return all;
}

RenderedView Rasterizer::forward_splats(const ViewSplats& splats, const CameraView& view,
                                        const RenderSettings& settings) {
  TensorCheck check(impl_->device);
  const SplatRows rows = rows_of(splats, check);
  impl_->backend().forward_splats(rows, view, settings, impl_->begin_view(view, splats.splats.options()));
  return impl_->rendered;
}

torch::Tensor Rasterizer::backward_splats(const RenderedViewGrad& grad) {
  const ViewState& view = impl_->backend().view_state();
  view.check_rows("backward_splats()");
  const ImageGradArrays image = impl_->image_grad(grad);
  constexpr std::int64_t kColumns = sizeof(SplatGradSum) / sizeof(float);
  const torch::Tensor splat_grads = torch::empty({view.n_given_rows, kColumns}, impl_->rendered.color.options());
  impl_->backend().backward_splats(image, rows_at<SplatGradSum>("splat_grads", splat_grads));
  return splat_grads;
}

torch::Tensor Rasterizer::score_splats(const torch::Tensor& error) {
  const ViewState& view = impl_->backend().view_state();
  view.check_rows("score_splats()");
  const float* const image = impl_->error_image(error);
  constexpr std::int64_t kColumns = sizeof(ScoreSums) / sizeof(std::int32_t);
  const torch::Tensor sums =
      torch::empty({view.n_given_rows, kColumns}, impl_->rendered.color.options().dtype(torch::kInt32));
  impl_->backend().score_splats(image, rows_at<ScoreSums>("sums", sums));
  return sums;
}

RenderedView Rasterizer::reblend(ForwardKernel kernel) {
  impl_->backend().reblend(kernel);
  return impl_->rendered;
}

torch::Tensor Rasterizer::reblend_backward(BackwardKernel kernel, const RenderedViewGrad& grad) {
  impl_->backend().reblend_backward(kernel, impl_->image_grad(grad));
  constexpr std::int64_t kColumns = sizeof(SplatGradSum) / sizeof(float), kUsed = sizeof(SplatGrad) / sizeof(float);
  return tensor_of(impl_->backend().splat_grads(), {impl_->backend().n_rows(), kColumns},
                   impl_->rendered.color.options(), torch::kFloat32)
      .narrow(1, 0, kUsed);
}

ViewSize Rasterizer::view_size() const {
  return {impl_->backend().n_splats(), impl_->backend().bins().n_pairs};
}

std::int64_t Rasterizer::memory_bytes() const {
  return impl_->backend().memory_bytes();
}

void Rasterizer::release_memory() {
  impl_->release_memory();
}

void Rasterizer::score(const torch::Tensor& error, const GaussianScores& scores) {
  const ViewState& view = impl_->backend().view_state();
  view.check_gaussians("score()");
  const float* const image = impl_->error_image(error);
  TensorCheck check(impl_->device);
  check.bind("N", view.n_gaussians);
  impl_->backend().score(image, arrays_of(scores, check));
}

torch::Tensor Rasterizer::row_entries() const {
  B3DGS_CHECK(impl_->rendered.alpha.defined(), "row_entries() before any forward()");
  const torch::Tensor last = tensor_of(impl_->backend().last_ids(), impl_->rendered.alpha.sizes(),
                                       impl_->rendered.alpha.options(), torch::kInt32);
  return last.sum(/*dim=*/1, /*keepdim=*/false, torch::kInt64).add_(last.size(1));
}

ViewLoad Rasterizer::count_load() const {
  B3DGS_CHECK(impl_->rendered.alpha.defined(), "count_load() before any forward()");
  const auto options = impl_->rendered.alpha.options();
  RasterizerBackend& backend = impl_->backend();
  ViewLoad load;
  load.processed = torch::empty(impl_->rendered.alpha.sizes(), options.dtype(torch::kInt32));
  load.contributing = torch::empty_like(load.processed);
  backend.count_load(load.processed.data_ptr<std::int32_t>(), load.contributing.data_ptr<std::int32_t>());
  const torch::Tensor ends =
      tensor_of(backend.bins().tile_offsets, {backend.grid().n_tiles() + 1}, options, torch::kInt64).cpu();
  load.tile_lists = ends.slice(0, 1) - ends.slice(0, 0, -1);
  load.processed = load.processed.cpu();
  load.contributing = load.contributing.cpu();
  return load;
}

}  // namespace b3dgs
