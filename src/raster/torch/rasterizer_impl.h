// Behind Rasterizer: from tensors to argument structs. Checks tensors, allocates outputs, selects the device. The code
// that this header calls does not use torch. For the sources of this folder.
#pragma once

#include <algorithm>
#include <memory>
#include <utility>
#include <vector>

#include "core/check.h"
#include "raster/cpu/rasterize_cpu.h"
#include "raster/torch/fused_step.h"
#include "raster/torch/rasterizer.h"
#include "raster/torch/tensor_arrays.h"
#include "raster/torch/tensor_storage.h"

// Set by the build where both nvcc and a LibTorch with CUDA are there.
#if B3DGS_TORCH_CUDA
#include "raster/cuda/rasterize_cuda.h"
#include "raster/torch/torch_launch.h"
#endif

namespace b3dgs {

struct Rasterizer::Impl {
  explicit Impl(torch::Device where) : device(where) {}

  torch::Device device;
  cpu::Rasterizer cpu;
#if B3DGS_TORCH_CUDA
  std::unique_ptr<cuda::Rasterizer> cuda;  // created on first use, so that the CPU path never initialises CUDA
#endif
  RenderedView rendered;
  torch::Tensor color_storage, depth_storage, alpha_storage, means2d_storage;
  ViewStatistics statistics;
  std::int64_t n_gaussians = -1;  // of the last forward(); -1: none
  std::int64_t n_rows = -1;       // of the last forward_splats(); -1: none
  bool camera_gradient = false;   // of its settings
  double seen_share = 0;          // largest share of the Gaussians that a view of project_views() has seen
  static constexpr double kSeenMargin = 1.1;

  RenderedView forward(const GaussianTensors& gaussians, const PinholeView& view, const RenderSettings& settings,
                       cuda::ColorPass* colors) {
    const GaussianArrays arrays = arrays_of(gaussians, device);
    const ImageArrays out = begin_view(view, settings, gaussians.means.options());
    n_gaussians = arrays.n_gaussians;
    if (device.is_cpu()) {
      B3DGS_CHECK(colors == nullptr, "a ColorPass needs a GPU");
      cpu.forward(arrays, view, settings, out);
    }
#if B3DGS_TORCH_CUDA
    if (!device.is_cpu()) on_gpu().forward(arrays, view, settings, out, torch_launch_context(), colors);
#endif
    return rendered;
  }

  ViewSplats project(const GaussianTensors& gaussians, const PinholeView& view, const RenderSettings& settings,
                     cuda::ColorPass* colors) {
    const GaussianArrays arrays = arrays_of(gaussians, device);
    n_gaussians = n_rows = -1;
    ViewSplats out;
    const SplatAllocator allocate = [&](std::int64_t n) {
      out = allocate_splats(gaussians, n);
      return row_arrays_of(out);
    };
    if (device.is_cpu()) {
      B3DGS_CHECK(colors == nullptr, "a ColorPass needs a GPU");
      cpu.project(arrays, view, settings, allocate);
    }
#if B3DGS_TORCH_CUDA
    if (!device.is_cpu()) on_gpu().project(arrays, view, settings, allocate, torch_launch_context(), colors);
#endif
    return out;
  }

  /// rasterizer_splats.cpp
  std::vector<ViewSplats> project_views(const GaussianTensors& gaussians, const std::vector<PinholeView>& views,
                                        const std::vector<RenderSettings>& settings, cuda::ColorPass* colors);

  static ViewSplats allocate_splats(const GaussianTensors& gaussians, std::int64_t n) {
    constexpr std::int64_t kWords = sizeof(Splat) / sizeof(float);
    const torch::TensorOptions floats = gaussians.means.options();
    return {torch::empty({n, kWords}, floats), torch::empty({n, 2}, floats),
            torch::empty({n}, floats.dtype(torch::kInt32))};
  }
  static SplatRowArrays row_arrays_of(const ViewSplats& splats) {
    return {rows_at<Splat>("splats", splats.splats), rows_at<Vec2f>("extents", splats.extents),
            splats.radii.data_ptr<std::int32_t>()};
  }
  static ViewSplats first_rows(const ViewSplats& splats, std::int64_t n) {
    return {splats.splats.slice(0, 0, n), splats.extents.slice(0, 0, n), splats.radii.slice(0, 0, n)};
  }
  void note_seen(std::int64_t n_seen, std::int64_t n) {
    if (n > 0) seen_share = std::max(seen_share, static_cast<double>(n_seen) / static_cast<double>(n));
  }

  RenderedView forward_splats(const ViewSplats& splats, const PinholeView& view, const RenderSettings& settings) {
    TensorCheck check(device);
    const SplatRows rows = rows_of(splats, check);
    const ImageArrays out = begin_view(view, settings, splats.splats.options());
    n_rows = rows.n_splats;
    if (device.is_cpu()) cpu.forward_splats(rows, view, settings, out);
#if B3DGS_TORCH_CUDA
    if (!device.is_cpu()) on_gpu().forward_splats(rows, view, settings, out, torch_launch_context());
#endif
    return rendered;
  }

  /// Images for a view, whose rendering must follow.
  ImageArrays begin_view(const PinholeView& view, const RenderSettings& settings, const torch::TensorOptions& options) {
    place_tensor(rendered.color, color_storage, {view.height, view.width, 3}, options);
    place_tensor(rendered.depth, depth_storage, {view.height, view.width}, options);
    place_tensor(rendered.alpha, alpha_storage, {view.height, view.width}, options);
    n_gaussians = n_rows = -1;
    camera_gradient = settings.camera_gradient;
    return {rendered.color.data_ptr<float>(), rendered.depth.data_ptr<float>(), rendered.alpha.data_ptr<float>()};
  }

#if B3DGS_TORCH_CUDA
  cuda::Rasterizer& on_gpu() {
    if (cuda == nullptr) cuda = std::make_unique<cuda::Rasterizer>();
    return *cuda;
  }
#endif

  void backward(const GaussianArrays& arrays, const ImageGradArrays& grad, const GaussianGradArrays& out) {
    if (device.is_cpu()) return cpu.backward(arrays, grad, out);
#if B3DGS_TORCH_CUDA
    cuda->backward(arrays, grad, out, torch_launch_context());
#endif
  }

  void backward_to_splats(const GaussianArrays& arrays, const ImageGradArrays& grad, const SplatRecordArrays& out) {
    if (device.is_cpu()) return cpu.backward_to_splats(arrays, grad, out);
#if B3DGS_TORCH_CUDA
    cuda->backward_to_splats(arrays, grad, out, torch_launch_context());
#endif
  }

  void backward_splats(const ImageGradArrays& grad, SplatGradSum* out) {
    if (device.is_cpu()) return cpu.backward_splats(grad, out);
#if B3DGS_TORCH_CUDA
    cuda->backward_splats(grad, out, torch_launch_context());
#endif
  }

  void score_splats(const float* error, ScoreSums* out) {
    if (device.is_cpu()) return cpu.score_splats(error, out);
#if B3DGS_TORCH_CUDA
    cuda->score_splats(error, out, torch_launch_context());
#endif
  }

  void reblend(ForwardKernel kernel) {
    if (device.is_cpu()) return cpu.reblend(kernel);
#if B3DGS_TORCH_CUDA
    B3DGS_CHECK(cuda != nullptr, "reblend() before any forward()");
    cuda->reblend(kernel, torch_launch_context());
#endif
  }

  /// After the backward pass.
  void add_camera_gradient() {
    statistics.camera_grad = torch::Tensor();
    if (!camera_gradient) return;
    statistics.camera_grad = torch::from_blob(const_cast<double*>(camera_gradients()), {kCameraGradients},
                                              rendered.color.options().dtype(torch::kFloat64));
  }

  void score(const float* error, const ScoreArrays& out) {
    if (device.is_cpu()) return cpu.score(error, out);
#if B3DGS_TORCH_CUDA
    cuda->score(error, out, torch_launch_context());
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

  /// Offsets of the tiles' lists, and the number of tiles.
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

  const std::int32_t* last_ids() const {
#if B3DGS_TORCH_CUDA
    if (cuda != nullptr) return cuda->last_ids();
#endif
    return cpu.last_ids();
  }

  const double* camera_gradients() const {
#if B3DGS_TORCH_CUDA
    if (cuda != nullptr) return cuda->camera_gradient();
#endif
    return cpu.camera_gradient();
  }

  /// Checks gradients against the view of the last forward().
  ImageGradArrays image_grad(const RenderedViewGrad& grad) const {
    B3DGS_CHECK(rendered.color.defined(), "backward() before any forward()");
    TensorCheck check(device);
    check.bind("H", rendered.color.size(0));
    check.bind("W", rendered.color.size(1));
    if (grad.color.defined()) check.dims("grad.color", grad.color, {"H", "W", 3});
    if (grad.depth.defined()) check.dims("grad.depth", grad.depth, {"H", "W"});
    if (grad.alpha.defined()) check.dims("grad.alpha", grad.alpha, {"H", "W"});
    return {data_or_null(grad.color), data_or_null(grad.depth), data_or_null(grad.alpha)};
  }

  /// Checks an error against the view of the last forward().
  void check_error(const torch::Tensor& error) const {
    B3DGS_CHECK(rendered.alpha.defined(), "an error image before any forward()");
    TensorCheck check(device);
    check.bind("H", rendered.alpha.size(0));
    check.bind("W", rendered.alpha.size(1));
    check.dims("error", error, {"H", "W"});
  }

  /// Statistics with allocated gradients, not yet written. `radii` refers to the rasterizer's own array and is
  /// valid until the next forward().
  const ViewStatistics& make_statistics(std::int64_t n_gaussians) {
    const torch::TensorOptions options = rendered.color.options();
    place_tensor(statistics.means2d_grad, means2d_storage, {n_gaussians, 2}, options, /*spare_part=*/4);
    statistics.radii =
        torch::from_blob(const_cast<std::int32_t*>(radii()), {n_gaussians}, options.dtype(torch::kInt32));
    return statistics;
  }
};

}  // namespace b3dgs
