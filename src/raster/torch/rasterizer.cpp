// From tensors to argument structs: checks tensors, allocates outputs, selects the device. The code that this file
// calls does not use torch.

#include "raster/torch/rasterizer.h"

#include "core/check.h"
#include "raster/cpu/rasterize_cpu.h"
#include "raster/torch/fused_step.h"
#include "raster/torch/tensor_arrays.h"
#include "raster/torch/tensor_storage.h"

// Set by the build where both nvcc and a LibTorch with CUDA are there.
#if B3DGS_TORCH_CUDA
#include "raster/cuda/rasterize_cuda.h"
#include "raster/torch/torch_launch.h"
#endif

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

struct Rasterizer::Impl {
  explicit Impl(torch::Device where) : device(where) {}

  torch::Device device;
  cpu::Rasterizer cpu;
#if B3DGS_TORCH_CUDA
  std::unique_ptr<cuda::Rasterizer> cuda;  // created on first use, so that the CPU path never initialises CUDA
#endif
  RenderedView rendered;
  torch::Tensor color_storage, depth_storage, alpha_storage, means2d_storage, means2d_abs_storage;
  ViewStatistics statistics;
  std::int64_t n_gaussians = -1;   // of the last forward(); -1: none
  std::int64_t n_rows = -1;        // of the last forward_splats(); -1: none
  bool absolute_gradient = false;  // of its settings
  bool camera_gradient = false;
  double seen_share = 0;  // largest share of the Gaussians that a view of project_views() has seen
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

  std::vector<ViewSplats> project_views(const GaussianTensors& gaussians, const std::vector<PinholeView>& views,
                                        const std::vector<RenderSettings>& settings, cuda::ColorPass* colors) {
    B3DGS_CHECK(settings.size() == views.size(), "settings for ", settings.size(), " views of ", views.size());
    std::vector<ViewSplats> all;
#if B3DGS_TORCH_CUDA
    if (!device.is_cpu() && seen_share > 0) {
      const GaussianArrays arrays = arrays_of(gaussians, device);
      n_gaussians = n_rows = -1;
      const auto n = static_cast<double>(arrays.n_gaussians);
      const std::int64_t room =
          std::min(arrays.n_gaussians, static_cast<std::int64_t>(kSeenMargin * seen_share * n) + 1);
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
    absolute_gradient = settings.absolute_gradient;
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

  void absolute_gradients(float* out) const {
    if (device.is_cpu()) return cpu.absolute_gradients(out);
#if B3DGS_TORCH_CUDA
    cuda->absolute_gradients(out, torch_launch_context());
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

  SplatPairs pairs_of(const torch::Tensor& rows) const {
    const torch::TensorOptions floats = rendered.color.options(), integers = floats.dtype(torch::kInt64);
    constexpr std::int64_t kWords = sizeof(SplatGradSum) / sizeof(float);
    constexpr std::int64_t kAbsoluteWords = 2, kGradWords = kWords - kAbsoluteWords;
    const auto array = [](const auto* data, std::vector<std::int64_t> sizes, const torch::TensorOptions& options) {
      return torch::from_blob(const_cast<void*>(static_cast<const void*>(data)), sizes, options);
    };
    torch::Tensor places = rows, is_drawn, pair_sums;  // places in the order of slot_offsets
    BinnedSplats bins;
    std::int64_t n_splats = n_rows;
    if (device.is_cpu()) {
      bins = cpu.bins();
      pair_sums = array(cpu.pair_grads(), {bins.n_pairs, kGradWords}, floats);
      const torch::Tensor absolute = cpu.pair_abs() != nullptr
                                         ? array(cpu.pair_abs(), {bins.n_pairs, kAbsoluteWords}, floats)
                                         : torch::zeros({bins.n_pairs, kAbsoluteWords}, floats);
      pair_sums = torch::cat({pair_sums, absolute}, 1);
    }
#if B3DGS_TORCH_CUDA
    if (!device.is_cpu()) {
      bins = cuda->bins();
      n_splats = cuda->n_splats();
      pair_sums = array(cuda->pair_grads(), {bins.n_pairs, kWords}, floats);
      is_drawn = array(cuda->radii(), {n_rows}, floats.dtype(torch::kInt32)).index_select(0, rows) > 0;
      places =
          array(cuda->rank_of_row(), {n_rows}, floats.dtype(torch::kInt32)).index_select(0, rows).to(torch::kInt64);
      places = places.where(is_drawn, torch::zeros_like(places));
    }
#endif
    SplatPairs pairs{torch::zeros({n_rows}, integers), torch::empty({0, kWords}, floats)};
    if (rows.size(0) == 0 || n_splats == 0) return pairs;
    const torch::Tensor offsets = array(bins.slot_offsets, {n_splats + 1}, integers);
    const torch::Tensor first = offsets.index_select(0, places);
    torch::Tensor counts = offsets.index_select(0, places + 1) - first;
    if (is_drawn.defined()) counts = counts * is_drawn;
    pairs.counts.index_copy_(0, rows, counts);
    // Slot of each pair: its splat's first one, and its place among the splat's pairs.
    const torch::Tensor splat = torch::repeat_interleave(counts);
    const torch::Tensor before = counts.cumsum(0) - counts;
    const torch::Tensor slots = torch::arange(splat.size(0), integers) + (first - before).index_select(0, splat);
    pairs.sums = pair_sums.index_select(0, slots);
    return pairs;
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
    statistics.means2d_abs_grad = torch::Tensor();
    if (absolute_gradient) {
      torch::Tensor& absolute = statistics.means2d_abs_grad;
      place_tensor(absolute, means2d_abs_storage, {n_gaussians, 2}, options, /*spare_part=*/4);
    }
    statistics.radii =
        torch::from_blob(const_cast<std::int32_t*>(radii()), {n_gaussians}, options.dtype(torch::kInt32));
    return statistics;
  }
};

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
  if (impl_->absolute_gradient) impl_->absolute_gradients(statistics.means2d_abs_grad.data_ptr<float>());
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
  if (impl_->absolute_gradient) impl_->absolute_gradients(statistics.means2d_abs_grad.data_ptr<float>());
  impl_->add_camera_gradient();
  return statistics;
}

std::vector<ViewSplats> Rasterizer::project_views(const GaussianTensors& gaussians,
                                                  const std::vector<PinholeView>& views,
                                                  const std::vector<RenderSettings>& settings) {
  return impl_->project_views(gaussians, views, settings, nullptr);
}

ViewSplats Rasterizer::project(const GaussianTensors& gaussians, const PinholeView& view,
                               const RenderSettings& settings) {
  return impl_->project(gaussians, view, settings, nullptr);
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

SplatPairs Rasterizer::backward_pairs(const torch::Tensor& rows) const {
  B3DGS_CHECK(impl_->n_rows >= 0, "backward_pairs() before any backward_splats()");
  return impl_->pairs_of(rows);
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
    if (impl.absolute_gradient) impl.absolute_gradients(statistics.means2d_abs_grad.data_ptr<float>());
    impl.add_camera_gradient();
    return statistics;
  }
#endif
  (void)gaussians, (void)grad, (void)rest;
  throw LogicError(detail::concat("backward_blend() on ", impl.device.str(), " needs a forward() on a GPU before"));
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
  impl_->color_storage = impl_->depth_storage = impl_->alpha_storage = impl_->means2d_storage =
      impl_->means2d_abs_storage = torch::Tensor();
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
