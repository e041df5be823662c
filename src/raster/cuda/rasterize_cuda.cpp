// Runs the passes in order and owns the memory between them.

#include "raster/cuda/rasterize_cuda.h"

#include <memory>
#include <utility>
#include <vector>

#include "raster/args_check.h"
#include "raster/cuda/backward/backward_table.h"
#include "raster/cuda/forward/forward_scratch.h"
#include "raster/cuda/forward/forward_table.h"
#include "raster/cuda/host_wait.h"
#include "raster/cuda/passes.h"
#include "raster/math/invalid_gaussian.h"
#include "raster/math/project_splat.h"
#include "raster/math/tiling.h"
#include "raster/pair_limit.h"
#include "raster/view_state.h"

namespace b3dgs::cuda {
namespace {

/// For the error message about too many pairs. Waits for the device.
WidestGaussian widest_gaussian(const std::int32_t* n_tiles, std::int64_t n, const LaunchContext& context) {
  std::vector<std::int32_t> host(static_cast<std::size_t>(n));
  B3DGS_CUDA_CHECK(cudaMemcpyAsync(host.data(), n_tiles, host.size() * sizeof(std::int32_t), cudaMemcpyDeviceToHost,
                                   context.stream));
  B3DGS_CUDA_CHECK(cudaStreamSynchronize(context.stream));
  std::size_t widest = 0;
  for (std::size_t i = 0; i < host.size(); ++i) {
    if (host[i] > host[widest]) widest = i;
  }
  return {static_cast<std::int64_t>(widest), host[widest]};
}

void check_valid(const ViewCounts& counts, std::int64_t n_gaussians) {
  if (counts.first_invalid >= n_gaussians) return;
  throw InvalidGaussianError(counts.first_invalid, detail::concat("Gaussian ", counts.first_invalid, kInvalidText));
}

void check_kernels(const RenderSettings& settings) {
  B3DGS_CHECK(
      !settings.deterministic || !settings.keep_for_backward || settings.backward_kernel == BackwardKernel::kPerSplat,
      "deterministic gradients need the per-splat backward kernel");
}

}  // namespace

struct Rasterizer::Impl : ViewState {
  DeviceBuffer<Splat> splats;
  DeviceBuffer<Vec2f> extents;
  DeviceBuffer<std::int32_t> radii, n_tiles, last_ids;
  DeviceBuffer<std::uint32_t> depth_bits;
  DeviceBuffer<ViewCounts> counts;
  DeviceBuffer<float4> part_color;
  DeviceBuffer<float> part_depth, transmittance;
  ForwardScratch forward_scratch;
  PassScratch pass_scratch;
  DeviceBuffer<SplatGradSum> splat_grads, pair_grads;
  DeviceBuffer<double> camera_parts, camera_gradients;
  BinBuffers bin_buffers;
  PinnedValue<ViewCounts> host_counts;
  std::vector<std::unique_ptr<PinnedValue<ViewCounts>>> queued_counts;  // of the projections that were queued
  std::size_t n_queued = 0;
  std::int64_t n_queued_gaussians = 0;
  StreamMark counts_copied;

  // Of the last forward pass:
  BackwardKernel backward_kernel{};
  bool deterministic = false;
  BinnedView binned{};
  BucketParts parts{};       // memory for the bucket parts
  BucketParts kept_parts{};  // what the last blend stored there

  std::int64_t n_bucket_pixels() const {
    return binned.buckets.n_max * (std::int64_t{grid.tile.width} * grid.tile.height);
  }
  float2* allocate_bucket_ends(const LaunchContext& context) {
    float2* ends = nullptr;
    pass_scratch.allocate(context, [&](ScratchArrays& arrays) { ends = arrays.take<float2>(n_bucket_pixels()); });
    return ends;
  }
  /// Takes what the backward pass needs while this one can still be repeated.
  void make_room_for_backward(const LaunchContext& context) {
    allocate_bucket_ends(context);
    splat_grads.resize(n_splats, context);
    if (deterministic) pair_grads.resize(binned.bins.n_pairs, context);
    if (camera_gradient) {
      camera_parts.resize(kCameraGradientParts * kCameraGradients, context);
      camera_gradients.resize(kCameraGradients, context);
    }
  }
  template <class Visit>
  void visit_buffers(Visit&& visit) {
    visit(splats), visit(extents), visit(radii), visit(n_tiles), visit(last_ids), visit(depth_bits), visit(counts);
    visit(part_color), visit(part_depth), visit(transmittance), visit(splat_grads), visit(pair_grads);
    visit(pass_scratch), visit(camera_parts), visit(camera_gradients);
    forward_scratch.visit_buffers(visit);
    bin_buffers.visit_buffers(visit);
  }

  // The parts of a forward pass:
  /// Returns buffers for n rows.
  ProjectOutputs begin(std::int64_t n, const PinholeView& next_view, const RenderSettings& settings,
                       const LaunchContext& context);
  void project(const GaussianArrays& gaussians, const RenderSettings& settings, const ProjectOutputs& projected,
               ColorPass* colors, const LaunchContext& context);
  /// Begins the binning of n rows, and waits for the counts.
  ViewCounts count(const ProjectOutputs& projected, std::int64_t n, const LaunchContext& context);
  /// From the splats to the images.
  void draw(const ProjectOutputs& projected, std::int64_t n, const ViewCounts& counts, const RenderSettings& settings,
            const ImageArrays& out, const LaunchContext& context);

  /// Scores of each splat, in the memory of splat_grads.
  ScoreSums* score(const float* error, const LaunchContext& context);
  RanksOfRows ranks_of_rows() const { return {n_rows, radii.data(), binned.rank_of_gaussian}; }
  void blend_forward(ForwardKernel kernel, const LaunchContext& context);
  void blend_backward(BackwardKernel kernel, const ImageGradArrays& grad, const LaunchContext& context);
};

void Rasterizer::Impl::blend_forward(ForwardKernel kernel, const LaunchContext& context) {
  const BlendForwardArgs blend{binned.splats, binned.extents, binned.bins,          grid,
                               background,    rendered,       transmittance.data(), last_ids.data()};
  BlendForwardCudaArgs args{blend, binned.buckets, parts};
  forward_scratch.allocate(kernel, args, pass_scratch, context);
  B3DGS_CUDA_CHECK(cudaMemsetAsync(args.next_task, 0, sizeof(std::int32_t), context.stream));
  kForwardTable[static_cast<std::size_t>(kernel)].launch(args, context);
  kept_parts = parts_after(kernel, args);
}

void Rasterizer::Impl::blend_backward(BackwardKernel kernel, const ImageGradArrays& grad,
                                      const LaunchContext& context) {
  B3DGS_CHECK(parts.color != nullptr, "backward() after a forward() without keep_for_backward");
  B3DGS_CHECK(grad.depth == nullptr || parts.depth != nullptr,
              "gradient with respect to depth after a forward() without depth_gradient");
  const auto zeroed = [&](DeviceBuffer<SplatGradSum>& buffer, std::int64_t count) {
    SplatGradSum* const records = buffer.resize(count, context);
    B3DGS_CUDA_CHECK(
        cudaMemsetAsync(records, 0, static_cast<std::size_t>(count) * sizeof(SplatGradSum), context.stream));
    return records;
  };
  BlendBackwardCudaArgs args{};
  args.blend = {binned.splats, binned.extents,       binned.bins,     grid, background,
                rendered,      transmittance.data(), last_ids.data(), grad, nullptr};
  args.buckets = binned.buckets;
  args.parts = kept_parts;
  args.bucket_ends = allocate_bucket_ends(context);
  args.splat_grads = zeroed(splat_grads, n_splats);
  if (deterministic) args.pair_grads = zeroed(pair_grads, binned.bins.n_pairs);
  kBackwardTable[static_cast<std::size_t>(kernel)].launch(args, context);
  if (deterministic) sum_splat_grads({n_splats, binned.bins.slot_offsets, args.pair_grads, args.splat_grads}, context);
  if (inverse_depth && grad.depth != nullptr) {
    invert_depth_gradients(binned.splats, n_splats, args.splat_grads, context);
  }
}

Rasterizer::Rasterizer() : impl_(std::make_unique<Impl>()) {}
Rasterizer::~Rasterizer() = default;
Rasterizer::Rasterizer(Rasterizer&&) noexcept = default;
Rasterizer& Rasterizer::operator=(Rasterizer&&) noexcept = default;

ProjectOutputs Rasterizer::Impl::begin(std::int64_t n, const PinholeView& next_view, const RenderSettings& settings,
                                       const LaunchContext& context) {
  begin_view(next_view, make_tile_grid(next_view.width, next_view.height, settings.tile), settings);
  begin_stage(stages, Stage::kProject);
  return {splats.resize(n, context),  extents.resize(n, context),    radii.resize(n, context),
          n_tiles.resize(n, context), depth_bits.resize(n, context), counts.resize(1, context)};
}

void Rasterizer::Impl::project(const GaussianArrays& gaussians, const RenderSettings& settings,
                               const ProjectOutputs& projected, ColorPass* colors, const LaunchContext& context) {
  cuda::project({gaussians, view, settings.sh_degree, settings.near_plane, settings.culling, grid, projected, colors,
                 settings.antialiasing},
                context);
}

ViewCounts Rasterizer::Impl::count(const ProjectOutputs& projected, std::int64_t n, const LaunchContext& context) {
  B3DGS_CUDA_CHECK(
      cudaMemcpyAsync(host_counts.get(), projected.counts, sizeof(ViewCounts), cudaMemcpyDeviceToHost, context.stream));
  counts_copied.record(context.stream);
  begin_stage(stages, Stage::kBin);
  list_seen(projected, n, bin_buffers, context);  // the device works on this while the host waits for the counts
  counts_copied.wait();
  const ViewCounts found = *host_counts.get();
  check_valid(found, n);
  return found;
}

void Rasterizer::Impl::draw(const ProjectOutputs& projected, std::int64_t n, const ViewCounts& counted,
                            const RenderSettings& settings, const ImageArrays& out, const LaunchContext& context) {
  begin_drawing(settings, out);
  n_splats = counted.n_splats;
  const bool keep_slots = settings.deterministic && settings.keep_for_backward;
  binned = bin({projected, n, counted.n_splats, counted.n_pairs, grid, settings.culling, keep_slots}, bin_buffers,
               pass_scratch, context);
  if (inverse_depth) invert_depths(bin_buffers.splats.data(), n_splats, context);

  begin_stage(stages, Stage::kBlendForward);
  parts = {};
  backward_kernel = settings.backward_kernel;
  deterministic = settings.deterministic;
  if (settings.keep_for_backward) {
    parts.color = part_color.resize(n_bucket_pixels(), context);
    if (settings.depth_gradient) parts.depth = part_depth.resize(n_bucket_pixels(), context);
    make_room_for_backward(context);
  }
  const std::int64_t n_pixels = std::int64_t{view.width} * view.height;
  transmittance.resize(n_pixels, context);
  last_ids.resize(n_pixels, context);
  blend_forward(settings.kernel, context);
  end_stage(stages);
}

void Rasterizer::forward(const GaussianArrays& gaussians, const PinholeView& view, const RenderSettings& settings,
                         const ImageArrays& out, const LaunchContext& context, ColorPass* colors) {
  check_render_args(gaussians, view, settings);
  check_kernels(settings);
  Impl& s = *impl_;
  const std::int64_t n = gaussians.n_gaussians;
  const ProjectOutputs projected = s.begin(n, view, settings, context);
  s.project(gaussians, settings, projected, colors, context);
  const ViewCounts counts = s.count(projected, n, context);
  if (has_too_many_pairs(counts.n_pairs)) {
    throw NumericError(
        too_many_pairs(counts.n_pairs, widest_gaussian(projected.n_tiles, n, context), s.grid.n_tiles()));
  }
  s.draw(projected, n, counts, settings, out, context);
  s.n_gaussians = n;
}

void Rasterizer::project(const GaussianArrays& gaussians, const PinholeView& view, const RenderSettings& settings,
                         const SplatAllocator& allocate, const LaunchContext& context, ColorPass* colors) {
  check_render_args(gaussians, view, settings);
  Impl& s = *impl_;
  const ProjectOutputs projected = s.begin(gaussians.n_gaussians, view, settings, context);
  s.project(gaussians, settings, projected, colors, context);
  const ViewCounts counts = s.count(projected, gaussians.n_gaussians, context);
  copy_seen({projected, s.bin_buffers.seen.data(), counts.n_splats, allocate(counts.n_splats)}, context);
  end_stage(s.stages);
}

void Rasterizer::queue_projection(std::size_t place, const GaussianArrays& gaussians, const PinholeView& view,
                                  const RenderSettings& settings, const SplatRowArrays& out, std::int64_t capacity,
                                  const LaunchContext& context, ColorPass* colors) {
  check_render_args(gaussians, view, settings);
  Impl& s = *impl_;
  const ProjectOutputs projected = s.begin(gaussians.n_gaussians, view, settings, context);
  s.project(gaussians, settings, projected, colors, context);
  while (s.queued_counts.size() <= place) s.queued_counts.push_back(std::make_unique<PinnedValue<ViewCounts>>());
  B3DGS_CUDA_CHECK(cudaMemcpyAsync(s.queued_counts[place]->get(), projected.counts, sizeof(ViewCounts),
                                   cudaMemcpyDeviceToHost, context.stream));
  s.n_queued = place + 1;
  s.n_queued_gaussians = gaussians.n_gaussians;
  s.counts_copied.record(context.stream);
  list_seen(projected, gaussians.n_gaussians, s.bin_buffers, context);
  copy_seen({projected, s.bin_buffers.seen.data(), capacity, out, projected.counts}, context);
  end_stage(s.stages);
}

std::vector<std::int64_t> Rasterizer::wait_for_projections() {
  Impl& s = *impl_;
  const std::size_t n_views = std::exchange(s.n_queued, 0);
  if (n_views > 0) s.counts_copied.wait();
  std::vector<std::int64_t> n_splats;
  for (std::size_t v = 0; v < n_views; ++v) {
    const ViewCounts& found = *s.queued_counts[v]->get();
    check_valid(found, s.n_queued_gaussians);
    n_splats.push_back(found.n_splats);
  }
  return n_splats;
}

void Rasterizer::forward_splats(const SplatRows& rows, const PinholeView& view, const RenderSettings& settings,
                                const ImageArrays& out, const LaunchContext& context) {
  const std::int64_t n = rows.n_splats;
  check_splat_args(n, view, settings);
  check_kernels(settings);
  Impl& s = *impl_;
  const ProjectOutputs projected = s.begin(n, view, settings, context);
  load_rows({rows, s.grid, settings.culling, projected}, context);
  const ViewCounts counts = s.count(projected, n, context);
  if (has_too_many_pairs(counts.n_pairs)) {
    throw NumericError(too_many_pairs(counts.n_pairs, widest_gaussian(projected.n_tiles, n, context), s.grid.n_tiles(),
                                      "the Gaussian of splat"));
  }
  s.draw(projected, n, counts, settings, out, context);
  s.n_rows = n;
}

ProjectBackwardCudaArgs Rasterizer::backward_blend(const GaussianArrays& gaussians, const ImageGradArrays& grad,
                                                   const LaunchContext& context) {
  Impl& s = *impl_;
  s.check_gaussians(gaussians);
  begin_stage(s.stages, Stage::kBlendBackward);
  s.blend_backward(s.backward_kernel, grad, context);
  end_stage(s.stages);
  ProjectBackwardCudaArgs args{
      gaussians, s.view, s.sh_degree, s.radii.data(), s.binned.rank_of_gaussian, s.binned.splats, s.splat_grads.data()};
  args.antialiasing = s.antialiasing;
  s.has_camera_gradient = s.camera_gradient;
  if (s.camera_gradient) {
    begin_stage(s.stages, Stage::kProjectBackward);
    cuda::camera_gradient({args, s.n_splats, s.camera_parts.data(), s.camera_gradients.data()}, context);
    end_stage(s.stages);
  }
  return args;
}

void Rasterizer::backward(const GaussianArrays& gaussians, const ImageGradArrays& grad, const GaussianGradArrays& out,
                          const LaunchContext& context) {
  ProjectBackwardCudaArgs args = backward_blend(gaussians, grad, context);
  args.grad = out;
  begin_stage(impl_->stages, Stage::kProjectBackward);
  project_backward(args, context);
  end_stage(impl_->stages);
}

void Rasterizer::backward_to_splats(const GaussianArrays& gaussians, const ImageGradArrays& grad,
                                    const SplatRecordArrays& out, const LaunchContext& context) {
  const ProjectBackwardCudaArgs args = backward_blend(gaussians, grad, context);
  begin_stage(impl_->stages, Stage::kProjectBackward);
  keep_splat_records({gaussians.n_gaussians, args.radii, args.rank_of_gaussian, args.splats, args.splat_grads, out},
                     context);
  end_stage(impl_->stages);
}

void Rasterizer::backward_splats(const ImageGradArrays& grad, SplatGradSum* out, const LaunchContext& context) {
  Impl& s = *impl_;
  B3DGS_CHECK(s.n_rows >= 0, "backward_splats() before any forward_splats()");
  begin_stage(s.stages, Stage::kBlendBackward);
  s.blend_backward(s.backward_kernel, grad, context);
  begin_stage(s.stages, Stage::kProjectBackward);
  rows_of_ranks(s.ranks_of_rows(), s.splat_grads.data(), out, context);
  end_stage(s.stages);
}

void Rasterizer::reblend(ForwardKernel kernel, const LaunchContext& context) {
  B3DGS_CHECK(impl_->has_view(), "reblend() before any forward()");
  impl_->blend_forward(kernel, context);
}

void Rasterizer::reblend_backward(BackwardKernel kernel, const ImageGradArrays& grad, const LaunchContext& context) {
  B3DGS_CHECK(impl_->has_view(), "reblend_backward() before any forward()");
  impl_->blend_backward(kernel, grad, context);
}

void Rasterizer::count_load(std::int32_t* processed, std::int32_t* contributing, const LaunchContext& context) const {
  const Impl& s = *impl_;
  B3DGS_CHECK(s.has_view(), "count_load() before any forward()");
  cuda::count_load({s.binned.splats, s.binned.bins, s.grid, processed, contributing}, context);
}

const double* Rasterizer::camera_gradient() const {
  B3DGS_CHECK(impl_->has_camera_gradient,
              "camera_gradient() without a forward() with camera_gradient and its backward()");
  return impl_->camera_gradients.data();
}

const std::int32_t* Rasterizer::rank_of_row() const {
  B3DGS_CHECK(impl_->n_rows >= 0, "rank_of_row() before any forward_splats()");
  return impl_->binned.rank_of_gaussian;
}

ScoreSums* Rasterizer::Impl::score(const float* error, const LaunchContext& context) {
  static_assert(sizeof(ScoreSums) <= sizeof(SplatGradSum), "fits into a splat's gradient");
  auto* const sums = reinterpret_cast<ScoreSums*>(splat_grads.resize(n_splats, context));
  const std::size_t bytes = static_cast<std::size_t>(n_splats) * sizeof(ScoreSums);
  B3DGS_CUDA_CHECK(cudaMemsetAsync(sums, 0, bytes, context.stream));
  cuda::score({binned.splats, binned.extents, binned.bins, grid, error, sums}, context);
  return sums;
}

void Rasterizer::score(const float* error, const ScoreArrays& out, const LaunchContext& context) {
  Impl& s = *impl_;
  B3DGS_CHECK(s.n_gaussians >= 0, "score() before any forward()");
  cuda::add_scores({s.binned.splats, s.n_splats, nullptr, s.score(error, context), out}, context);
}

void Rasterizer::score_splats(const float* error, ScoreSums* out, const LaunchContext& context) {
  Impl& s = *impl_;
  B3DGS_CHECK(s.n_rows >= 0, "score_splats() before any forward_splats()");
  rows_of_ranks(s.ranks_of_rows(), s.score(error, context), out, context);
}

const float* Rasterizer::splat_grads() const {
  return reinterpret_cast<const float*>(impl_->splat_grads.data());
}

const std::int32_t* Rasterizer::radii() const {
  return impl_->radii.data();
}
const std::int32_t* Rasterizer::last_ids() const {
  return impl_->last_ids.data();
}
const Splat* Rasterizer::splats() const {
  return impl_->binned.splats;
}
BinnedSplats Rasterizer::bins() const {
  return impl_->binned.bins;
}
TileGrid Rasterizer::grid() const {
  return impl_->grid;
}
std::int64_t Rasterizer::n_splats() const {
  return impl_->n_splats;
}

std::int64_t Rasterizer::memory_bytes() const {
  std::int64_t bytes = 0;
  impl_->visit_buffers([&](const auto& buffer) { bytes += buffer.bytes(); });
  return bytes;
}
void Rasterizer::release_memory() {
  impl_->forget_view();
  impl_->visit_buffers([](auto& buffer) { buffer.release(); });
}

}  // namespace b3dgs::cuda
