// Converts tensors to the arrays of RasterizerBackend: checks tensors, allocates outputs, selects the device.
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

/// Returns a tensor that refers to memory of the backend.
template <class T>
torch::Tensor tensor_of(const T* data, torch::IntArrayRef sizes, const torch::TensorOptions& options,
                        torch::ScalarType type) {
  return torch::from_blob(const_cast<T*>(data), sizes, options.dtype(type));
}

ViewSplats allocate_splats(const GaussianTensors& gaussians, std::int64_t n) {
  const torch::TensorOptions floats = gaussians.means.options();
  return {torch::empty({n, kWords<Splat>}, floats), torch::empty({n, 2}, floats),
          torch::empty({n}, floats.dtype(torch::kInt32))};
}

SplatRowArrays row_arrays_of(const ViewSplats& splats) {
  return {rows_at<Splat>(splats.splats), rows_at<Vec2f>(splats.extents), splats.radii.data_ptr<std::int32_t>()};
}

}  // namespace

Rasterizer::Rasterizer(torch::Device device) : device_(device) {
  if (device.is_cpu() || kTorchHasCuda) return;
  input_error("device ", device.str(), " is not supported: this build's LibTorch has no CUDA; use --device cpu");
}

/// Makes the backend on first use, so that a GPU is initialised only then.
RasterizerBackend& Rasterizer::backend() const {
  if (backend_ == nullptr && device_.is_cpu()) backend_ = cpu::make_rasterizer();
#if B3DGS_TORCH_CUDA
  if (backend_ == nullptr) backend_ = cuda::make_rasterizer(torch_launch_context);
#endif
  return *backend_;
}

/// Returns the images for a view, whose rendering must follow.
ImageArrays Rasterizer::begin_view(const CameraView& view, const torch::TensorOptions& options) {
  backend().forget_view();
  camera_center_ = view.center;
  place_tensor(rendered_.color, color_storage_, {view.height, view.width, 3}, options);
  place_tensor(rendered_.depth, depth_storage_, {view.height, view.width}, options);
  place_tensor(rendered_.alpha, alpha_storage_, {view.height, view.width}, options);
  return {rendered_.color.data_ptr<float>(), rendered_.depth.data_ptr<float>(), rendered_.alpha.data_ptr<float>()};
}

ImageGradArrays Rasterizer::image_grad(const RenderedViewGrad& grad) const {
  B3DGS_CHECK(rendered_.color.defined(), "backward() before any forward()");
  TensorCheck check(device_);
  check.dims("color", rendered_.color, {"H", "W", 3});
  if (grad.color.defined()) check.dims("grad.color", grad.color, {"H", "W", 3});
  if (grad.depth.defined()) check.dims("grad.depth", grad.depth, {"H", "W"});
  if (grad.alpha.defined()) check.dims("grad.alpha", grad.alpha, {"H", "W"});
  return {data_or_null(grad.color), data_or_null(grad.depth), data_or_null(grad.alpha)};
}

const float* Rasterizer::error_image(const torch::Tensor& error) const {
  TensorCheck check(device_);
  check.dims("alpha", rendered_.alpha, {"H", "W"});
  check.dims("error", error, {"H", "W"});
  return error.data_ptr<float>();
}

/// Allocates the gradients. `radii` refers to the backend's own array and is valid until the next forward().
ViewStatistics& Rasterizer::begin_statistics(std::int64_t n) {
  const torch::TensorOptions options = rendered_.color.options();
  place_tensor(statistics_.means2d_grad, means2d_storage_, {n, 2}, options, /*spare_part=*/4);
  statistics_.radii = tensor_of(backend().radii(), {n}, options, torch::kInt32);
  return statistics_;
}

/// Must be called after the backward pass.
const ViewStatistics& Rasterizer::finish_statistics() {
  statistics_.camera_grad = torch::Tensor();
  if (backend().view_state().has_camera_gradient) {
    statistics_.camera_grad =
        tensor_of(backend().camera_gradient(), {kCameraGradients}, rendered_.color.options(), torch::kFloat64);
  }
  return statistics_;
}

RenderedView Rasterizer::forward(const GaussianTensors& gaussians, const CameraView& view,
                                 const RenderSettings& settings) {
  const GaussianArrays arrays = arrays_of(gaussians, device_);
  backend().forward(arrays, view, settings, begin_view(view, gaussians.means.options()));
  return rendered_;
}

ViewStatistics Rasterizer::backward(const GaussianTensors& gaussians, const RenderedViewGrad& grad,
                                    GaussianTensors& grads) {
  const GaussianArrays arrays = arrays_of(gaussians, device_);
  const ImageGradArrays image = image_grad(grad);
  float* const means2d = begin_statistics(arrays.n_gaussians).means2d_grad.data_ptr<float>();
  backend().backward(arrays, image, make_gradients(gaussians, grads, means2d));
  return finish_statistics();
}

ViewStatistics Rasterizer::backward_blend(const GaussianTensors& gaussians, const RenderedViewGrad& grad,
                                          cuda::ProjectBackwardCudaArgs& rest) {
  const GaussianArrays arrays = arrays_of(gaussians, device_);
  const ImageGradArrays image = image_grad(grad);
  float* const means2d = begin_statistics(arrays.n_gaussians).means2d_grad.data_ptr<float>();
  backend().backward_blend(arrays, image, means2d, rest);
  return finish_statistics();
}

ViewStatistics Rasterizer::backward_to_splats(const GaussianTensors& gaussians, const RenderedViewGrad& grad,
                                              const SplatRecordTensors& out) {
  const GaussianArrays arrays = arrays_of(gaussians, device_);
  const ImageGradArrays image = image_grad(grad);
  TensorCheck check(device_);
  check.bind("N", arrays.n_gaussians);
  const torch::Tensor& means2d = begin_statistics(arrays.n_gaussians).means2d_grad;
  backend().backward_to_splats(arrays, image, arrays_of(out, view_size().n_splats, check, means2d));
  return finish_statistics();
}

ViewSplats Rasterizer::project(const GaussianTensors& gaussians, const CameraView& view,
                               const RenderSettings& settings) {
  ViewSplats out;
  out.n_second = backend().project(arrays_of(gaussians, device_), view, settings, [&](std::int64_t n) {
    out = allocate_splats(gaussians, n);
    return row_arrays_of(out);
  });
  return out;
}

std::vector<ViewSplats> Rasterizer::project_views(const GaussianTensors& gaussians,
                                                  const std::vector<CameraView>& views,
                                                  const std::vector<RenderSettings>& settings) {
  B3DGS_CHECK(settings.size() == views.size(), "settings for ", settings.size(), " views of ", views.size());
  const auto note_seen = [&](std::int64_t n_seen) {
    if (n_seen > 0)
      seen_share_ = std::max(seen_share_, static_cast<double>(n_seen) / static_cast<double>(gaussians.size()));
  };
  std::vector<ViewSplats> all;
  if (device_.is_cpu() || seen_share_ == 0) {
    for (std::size_t v = 0; v < views.size(); ++v) {
      all.push_back(project(gaussians, views[v], settings[v]));
      note_seen(all[v].size());
    }
    return all;
  }
  const GaussianArrays arrays = arrays_of(gaussians, device_);
  constexpr double kSeenMargin = 1.1;
  const double n_expected = kSeenMargin * seen_share_ * static_cast<double>(arrays.n_gaussians);
  const std::int64_t capacity = std::min(arrays.n_gaussians, static_cast<std::int64_t>(n_expected) + 1);
  for (std::size_t v = 0; v < views.size(); ++v) {
    all.push_back(allocate_splats(gaussians, capacity));
    backend().queue_projection(v, arrays, views[v], settings[v], row_arrays_of(all[v]), capacity);
  }
  const std::vector<SplatCounts> counts = backend().wait_for_projections();
  for (std::size_t v = 0; v < views.size(); ++v) {
    const auto [n_first, n_second] = counts[v];
    note_seen(n_first);
    if (n_first > capacity) {
      all[v] = project(gaussians, views[v], settings[v]);
      continue;
    }
    for (torch::Tensor* tensor : {&all[v].splats, &all[v].extents, &all[v].radii}) {
      *tensor = tensor->slice(0, 0, n_first);
    }
    all[v].n_second = n_second;
  }
  return all;
}

RenderedView Rasterizer::forward_splats(const ViewSplats& splats, const CameraView& view,
                                        const RenderSettings& settings) {
  TensorCheck check(device_);
  const SplatRows rows = rows_of(splats, check);
  backend().forward_splats(rows, view, settings, begin_view(view, splats.splats.options()));
  return rendered_;
}

torch::Tensor Rasterizer::backward_splats(const RenderedViewGrad& grad) {
  const LastView& view = backend().view_state();
  view.check_rows("backward_splats()");
  const ImageGradArrays image = image_grad(grad);
  const torch::Tensor sums = torch::empty({view.n_given_rows, kWords<SplatGradSum>}, rendered_.color.options());
  backend().backward_splats(image, rows_at<SplatGradSum>(sums));
  return sums;
}

torch::Tensor Rasterizer::score_splats(const torch::Tensor& error) {
  const LastView& view = backend().view_state();
  view.check_rows("score_splats()");
  const float* const image = error_image(error);
  const torch::Tensor sums =
      torch::empty({view.n_given_rows, kWords<ScoreSums>}, rendered_.color.options().dtype(torch::kInt32));
  backend().score_splats(image, rows_at<ScoreSums>(sums));
  return sums;
}

SurfaceView Rasterizer::geometry(const GaussianTensors& gaussians, DepthKind kind) {
  const LastView& view = backend().view_state();
  view.check_gaussians("geometry()");
  const GaussianArrays arrays = arrays_of(gaussians, device_);
  const torch::TensorOptions options = rendered_.color.options();
  const std::int64_t height = view.view.height, width = view.view.width;
  SurfaceView out{torch::empty({height, width}, options), torch::empty({height, width, 3}, options),
                  torch::empty({height, width}, options)};
  backend().geometry(arrays, kind,
                     {out.depth.data_ptr<float>(), out.normal.data_ptr<float>(), out.confidence.data_ptr<float>()});
  return out;
}

void Rasterizer::score(const torch::Tensor& error, const GaussianScores& scores) {
  const LastView& view = backend().view_state();
  view.check_gaussians("score()");
  const float* const image = error_image(error);
  TensorCheck check(device_);
  check.bind("N", view.n_gaussians);
  backend().score(image, arrays_of(scores, check));
}

RenderedView Rasterizer::reblend(ForwardKernel kernel) {
  backend().reblend(kernel);
  return rendered_;
}

torch::Tensor Rasterizer::reblend_backward(const RenderedViewGrad& grad) {
  backend().reblend_backward(image_grad(grad));
  return tensor_of(backend().splat_grads(), {backend().n_rows(), kWords<SplatGradSum>}, rendered_.color.options(),
                   torch::kFloat32)
      .narrow(1, 0, kWords<SplatGrad>);
}

KernelOccupancy Rasterizer::measure_occupancy(ForwardKernel kernel) {
  return backend().measure_occupancy(kernel);
}

ViewSize Rasterizer::view_size() const {
  return {backend().n_splats(), backend().bins().n_pairs};
}

std::int64_t Rasterizer::memory_bytes() const {
  return backend().memory_bytes();
}

void Rasterizer::release_memory() {
  if (backend_ != nullptr) backend_->release_memory();
  color_storage_ = depth_storage_ = alpha_storage_ = means2d_storage_ = torch::Tensor();
  rendered_ = {};
  statistics_ = {};
}

torch::Tensor Rasterizer::row_entries() const {
  B3DGS_CHECK(rendered_.alpha.defined(), "row_entries() before any forward()");
  const torch::Tensor last =
      tensor_of(backend().last_ids(), rendered_.alpha.sizes(), rendered_.alpha.options(), torch::kInt32);
  return last.sum(/*dim=*/1, /*keepdim=*/false, torch::kInt64).add_(last.size(1));
}

ViewLoad Rasterizer::count_load() const {
  B3DGS_CHECK(rendered_.alpha.defined(), "count_load() before any forward()");
  const torch::TensorOptions options = rendered_.alpha.options();
  ViewLoad load;
  load.processed = torch::empty(rendered_.alpha.sizes(), options.dtype(torch::kInt32));
  load.contributing = torch::empty_like(load.processed);
  backend().count_load(load.processed.data_ptr<std::int32_t>(), load.contributing.data_ptr<std::int32_t>());
  const torch::Tensor ends =
      tensor_of(backend().bins().tile_offsets, {backend().grid().n_tiles() + 1}, options, torch::kInt64).cpu();
  load.tile_lists = ends.slice(0, 1) - ends.slice(0, 0, -1);
  load.processed = load.processed.cpu();
  load.contributing = load.contributing.cpu();
  return load;
}

ViewStatistics SplatOwner::keep(const ViewSplats& splats, const torch::Tensor& splat_grads, std::int64_t n_gaussians,
                                const SplatRecordTensors& out) {
  TensorCheck check(splats.splats);
  const SplatRows rows = rows_of(splats, check);
  const auto* const sums = check.rows<SplatGradSum>("splat_grads", splat_grads, "M");
  check.bind("N", n_gaussians);
  const torch::TensorOptions options = splats.splats.options();
  constexpr std::int64_t kSpare = 4;
  place_tensor(statistics_.means2d_grad, means2d_storage_, {n_gaussians, 2}, options, kSpare);
  place_tensor(statistics_.radii, radii_storage_, {n_gaussians}, options.dtype(torch::kInt32), kSpare);
  const KeepSplatsArgs args{n_gaussians, rows, sums, arrays_of(out, rows.n_splats, check, statistics_.means2d_grad),
                            statistics_.radii.data_ptr<std::int32_t>()};
  if (check.is_cpu()) cpu::keep_splats(args);
#if B3DGS_TORCH_CUDA
  if (!check.is_cpu()) cuda::keep_splats(args, torch_launch_context());
#endif
  return statistics_;
}

void add_splat_scores(const ViewSplats& splats, const torch::Tensor& scores, const GaussianScores& out) {
  TensorCheck check(splats.splats);
  const SplatRows rows = rows_of(splats, check);
  const auto* const sums = check.rows<ScoreSums>("scores", scores, "M", torch::kInt32);
  const AddScoresArgs args{rows.splats, rows.n_splats, sums, arrays_of(out, check)};
  if (check.is_cpu()) cpu::add_scores(args);
#if B3DGS_TORCH_CUDA
  if (!check.is_cpu()) cuda::add_scores(args, /*radii=*/nullptr, torch_launch_context());
#endif
}

torch::Tensor camera_parts(const GaussianTensors& gaussians, const ViewSplats& splats, const torch::Tensor& splat_grads,
                           const CameraView& view, const RenderSettings& settings) {
  TensorCheck check(splats.splats);
  const SplatRows rows = rows_of(splats, check);
  const auto* const sums = check.rows<SplatGradSum>("splat_grads", splat_grads, "M");
  const torch::TensorOptions options = splats.splats.options();
  const torch::Tensor parts = torch::empty({rows.n_splats, kCameraGradients}, options);
  const GaussianArrays arrays = arrays_of(gaussians, options.device());
  if (check.is_cpu()) {
    cpu::camera_parts({arrays, view, settings.sh_degree, settings.antialiasing}, rows, sums, parts.data_ptr<float>());
  }
#if B3DGS_TORCH_CUDA
  if (!check.is_cpu()) {
    cuda::ProjectBackwardCudaArgs backward{arrays, view, settings.sh_degree, nullptr, rows.splats, sums};
    backward.antialiasing = settings.antialiasing;
    const torch::Tensor scratch =
        torch::empty({cuda::kCameraGradientParts + 1, kCameraGradients}, options.dtype(torch::kFloat64));
    double* const sum = scratch.data_ptr<double>();  // not used, like the parts of blocks after it
    cuda::camera_gradient({backward, nullptr, rows.n_splats, sum + kCameraGradients, sum, parts.data_ptr<float>()},
                          torch_launch_context());
  }
#endif
  return parts;
}

torch::Tensor sum_camera_parts(const torch::Tensor& parts) {
  TensorCheck(parts).dims("parts", parts, {"M", kCameraGradients});
  const torch::TensorOptions doubles = parts.options().dtype(torch::kFloat64);
  const torch::Tensor sum = torch::empty({kCameraGradients}, doubles);
  if (parts.is_cpu()) cpu::sum_camera_parts(parts.data_ptr<float>(), parts.size(0), sum.data_ptr<double>());
#if B3DGS_TORCH_CUDA
  if (!parts.is_cpu()) {
    const torch::Tensor scratch = torch::empty({cuda::kCameraGradientParts, kCameraGradients}, doubles);
    cuda::sum_camera_parts(parts.data_ptr<float>(), parts.size(0), scratch.data_ptr<double>(), sum.data_ptr<double>(),
                           torch_launch_context());
  }
#endif
  return sum;
}

}  // namespace b3dgs
