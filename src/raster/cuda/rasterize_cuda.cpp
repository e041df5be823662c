// Runs the passes in order and owns the memory between them.

#include <algorithm>
#include <functional>
#include <memory>
#include <utility>
#include <vector>

#include "raster/checks.h"
#include "raster/cuda/blend_kernels.h"
#include "raster/cuda/device_buffer.h"
#include "raster/cuda/passes.h"
#include "raster/cuda/view_counts.h"
#include "raster/math/tiling.h"
#include "raster/rasterizer_backend.h"

namespace b3dgs::cuda {
namespace {

void check_settings(const RenderSettings& settings) {
  B3DGS_CHECK(settings.tile.width == kCudaTileSide && settings.tile.height == kCudaTileSide, "tile is ",
              settings.tile.width, " x ", settings.tile.height, " px, expected 16 x 16 on CUDA");
  B3DGS_CHECK(
      !settings.deterministic || !settings.keep_for_backward || settings.backward_kernel == BackwardKernel::kPerBucket,
      "deterministic gradients need the per-bucket backward kernel");
}

class CudaBackend final : public RasterizerBackend {
 public:
  explicit CudaBackend(std::function<LaunchContext()> context) : context_(std::move(context)) {}

  void forward(const GaussianArrays& gaussians, const CameraView& view, const RenderSettings& settings,
               const ImageArrays& out) override {
    check_render_args(gaussians, view, settings);
    check_settings(settings);
    const LaunchContext context = context_();
    // Lists and the colours of a ColorPass do not depend on each other, and neither fills the device. Projection and
    // lists are in the side stream, which has priority, so that lists wait for no event.
    ColorPass* const pass = settings.color_pass;
    const LaunchContext lists = pass != nullptr ? side_.fork(context) : context;
    ProjectCudaArgs args;
    try {
      args = begin_gaussians(gaussians, view, settings, lists, /*is_drawn=*/true);
      cuda::project(args, lists);
      if (pass != nullptr) side_.join(context);  // colours follow the projection
      bin_view(args.out, settings, "Gaussian", lists, [&] {
        if (pass == nullptr) return;
        color_splats(args, pass, colored_reader_.begin(), context);
        colored_reader_.mark(context);
      });
    } catch (...) {
      if (pass != nullptr) side_.join(context);
      counts_reader_.finish();
      colored_reader_.finish();
      throw;
    }
    if (pass != nullptr) side_.join(context);
    const ProjectOutputs& projected = args.out;
    if (settings.camera_gradient) list_seen(projected, n_rows_, bin_buffers_, context);
    draw(projected, settings, out, context);
    if (pass != nullptr) colored_reader_.wait();  // whether all colours are valid
    state_.n_gaussians = gaussians.n_gaussians;
  }

  void backward(const GaussianArrays& gaussians, const ImageGradArrays& grad, const GaussianGradArrays& out) override {
    const LaunchContext context = context_();
    ProjectBackwardCudaArgs args = blend_and_prepare(gaussians, grad, context);
    args.grad = out;
    begin_stage(state_.settings.stages, Stage::kProjectBackward);
    project_backward(args, context);
    end_stage(state_.settings.stages);
  }

  void backward_blend(const GaussianArrays& gaussians, const ImageGradArrays& grad, float* means2d,
                      ProjectBackwardCudaArgs& rest) override {
    rest = blend_and_prepare(gaussians, grad, context_());
    rest.grad.means2d = means2d;
  }

  void backward_to_splats(const GaussianArrays& gaussians, const ImageGradArrays& grad,
                          const SplatRecordArrays& out) override {
    const LaunchContext context = context_();
    const ProjectBackwardCudaArgs args = blend_and_prepare(gaussians, grad, context);
    begin_stage(state_.settings.stages, Stage::kProjectBackward);
    std::int32_t* const n_records = sums_.n_records.resize(1, context);
    B3DGS_CUDA_CHECK(cudaMemsetAsync(n_records, 0, sizeof(std::int32_t), context.stream));
    keep_splat_records({gaussians.n_gaussians, args.radii, args.splats, args.splat_grads, n_records, out}, context);
    end_stage(state_.settings.stages);
  }

  std::int64_t project(const GaussianArrays& gaussians, const CameraView& view, const RenderSettings& settings,
                       const SplatAllocator& allocate) override {
    check_render_args(gaussians, view, settings);
    const LaunchContext context = context_();
    const ProjectOutputs projected = project_undrawn(gaussians, view, settings, context);
    counts_reader_.copy(projected.counts, context);
    list_seen(projected, n_first_rows_, bin_buffers_, context);
    const ViewCounts counts = counts_reader_.wait();
    copy_seen({projected, bin_buffers_.seen.data(), counts.n_splats, allocate(counts.n_splats)}, context);
    end_stage(state_.settings.stages);
    return counts.n_second;
  }

  void queue_projection(std::size_t index, const GaussianArrays& gaussians, const CameraView& view,
                        const RenderSettings& settings, const SplatRowArrays& out, std::int64_t capacity) override {
    check_render_args(gaussians, view, settings);
    const LaunchContext context = context_();
    const ProjectOutputs projected = project_undrawn(gaussians, view, settings, context);
    while (queue_.counts.size() <= index) queue_.counts.push_back(std::make_unique<PinnedValue<ViewCounts>>());
    B3DGS_CUDA_CHECK(cudaMemcpyAsync(queue_.counts[index]->get(), projected.counts, sizeof(ViewCounts),
                                     cudaMemcpyDeviceToHost, context.stream));
    queue_.n = index + 1;
    queue_.copied.record(context.stream);
    list_seen(projected, n_first_rows_, bin_buffers_, context);
    copy_seen({projected, bin_buffers_.seen.data(), capacity, out, projected.counts}, context);
    end_stage(state_.settings.stages);
  }

  std::vector<SplatCounts> wait_for_projections() override {
    const std::size_t n_views = std::exchange(queue_.n, 0);
    if (n_views > 0) queue_.copied.wait();
    std::vector<SplatCounts> counts;
    for (std::size_t v = 0; v < n_views; ++v) {
      const ViewCounts& found = *queue_.counts[v]->get();
      check_valid(found);
      counts.push_back({found.n_splats, found.n_second});
    }
    return counts;
  }

  void forward_splats(const SplatRows& rows, const CameraView& view, const RenderSettings& settings,
                      const ImageArrays& out) override {
    const std::int64_t n = rows.n_splats;
    check_splat_args(n, view, settings);
    check_settings(settings);
    const LaunchContext context = context_();
    const ProjectOutputs projected = begin(n, view, settings, context, /*is_drawn=*/true);
    sums_.are_zero = false;
    load_rows({rows, state_.grid, settings.culling, projected}, context);
    if (n_rows_ > n) {
      ProjectCudaArgs second;
      second.gaussians.n_gaussians = n;
      second.view = view;
      second.culling = settings.culling;
      second.grid = state_.grid;
      second.out = projected;
      add_second(second, context);
    }
    bin_view(projected, settings, "the Gaussian of splat", context);
    draw(projected, settings, out, context);
    state_.n_given_rows = n;
  }

  void backward_splats(const ImageGradArrays& grad, SplatGradSum* out) override {
    state_.check_rows("backward_splats()");
    const LaunchContext context = context_();
    begin_stage(state_.settings.stages, Stage::kBlendBackward);
    sum_rows(out, context,
             [&](SplatGradSum* sums) { blend_backward(state_.settings.backward_kernel, grad, sums, context); });
    end_stage(state_.settings.stages);
  }

  void score(const float* error, const ScoreArrays& out) override {
    state_.check_gaussians("score()");
    const LaunchContext context = context_();
    static_assert(sizeof(ScoreSums) <= sizeof(SplatGradSum), "fits into a splat's gradient");
    auto* const sums = reinterpret_cast<ScoreSums*>(sums_.splats.resize(n_rows_, context));
    sums_.are_zero = false;
    score_rows(error, sums, out.weight_sum != nullptr, context);
    join_second_splats(sums, context);
    add_scores({rows_.splats.data(), state_.n_gaussians, sums, out}, rows_.radii.data(), context);
  }

  void score_splats(const float* error, ScoreSums* out) override {
    state_.check_rows("score_splats()");
    const LaunchContext context = context_();
    sum_rows(out, context, [&](ScoreSums* sums) { score_rows(error, sums, /*wants_weights=*/true, context); });
  }

  void reblend(ForwardKernel kernel) override {
    state_.check_view("reblend()");
    blend_forward(kernel, context_());
  }

  void reblend_backward(BackwardKernel kernel, const ImageGradArrays& grad) override {
    state_.check_view("reblend_backward()");
    sums_.are_zero = false;  // the caller reads all rows
    blend_backward(kernel, grad, sums_.splats.data(), context_());
  }

  void count_load(std::int32_t* processed, std::int32_t* contributing) const override {
    state_.check_view("count_load()");
    cuda::count_load({lists(), processed, contributing}, context_());
  }

  const double* camera_gradient() const override {
    check_camera_gradient();
    return sums_.camera.data();
  }

  const float* splat_grads() const override { return reinterpret_cast<const float*>(sums_.splats.data()); }
  const std::int32_t* radii() const override { return rows_.radii.data(); }
  const std::int32_t* last_ids() const override { return blended_.last_ids.data(); }
  const Splat* splats() const override { return rows_.splats.data(); }
  std::int64_t n_rows() const override { return n_rows_; }
  BinnedSplats bins() const override { return binned_.bins; }

  std::int64_t memory_bytes() override {
    std::int64_t bytes = 0;
    visit_buffers([&](const auto& buffer) { bytes += buffer.bytes(); });
    return bytes;
  }
  void release_memory() override {
    state_.forget_view();
    visit_buffers([](auto& buffer) { buffer.release(); });
  }

 private:
  /// Returns buffers for n first splats and, of a panorama, as many second ones.
  ProjectOutputs begin(std::int64_t n, const CameraView& view, const RenderSettings& settings,
                       const LaunchContext& context, bool is_drawn) {
    n_first_rows_ = n;
    n_rows_ = n * splats_per_gaussian(view.lens);
    state_.begin_view(view, make_tile_grid(view.width, view.height, settings.tile), settings);
    begin_stage(state_.settings.stages, Stage::kProject);
    return {rows_.splats.resize(n_rows_, context),
            rows_.extents.resize(n_rows_, context),
            rows_.radii.resize(n_rows_, context),
            is_drawn ? rows_.list_growth.resize(kCounterStride * (state_.grid.n_tiles() + 1), context) : nullptr,
            rows_.counts.resize(1, context),
            nullptr};
  }

  /// Begins a view, up to the arguments of its projection: without the colours if a ColorPass computes them, so that
  /// color_splats() must follow.
  ProjectCudaArgs begin_gaussians(const GaussianArrays& gaussians, const CameraView& view,
                                  const RenderSettings& settings, const LaunchContext& context, bool is_drawn) {
    ProjectOutputs out = begin(gaussians.n_gaussians, view, settings, context, is_drawn);
    sums_.are_zero = is_drawn && settings.keep_for_backward;
    if (sums_.are_zero) out.sums = sums_.splats.resize(n_rows_, context);
    ProjectCudaArgs args{gaussians, view, settings.sh_degree, settings.near_plane, settings.culling, state_.grid, out};
    args.with_colors = settings.color_pass == nullptr;
    args.antialiasing = settings.antialiasing;
    return args;
  }

  /// Splats with their colours.
  ProjectOutputs project_undrawn(const GaussianArrays& gaussians, const CameraView& view,
                                 const RenderSettings& settings, const LaunchContext& context) {
    const ProjectCudaArgs args = begin_gaussians(gaussians, view, settings, context, /*is_drawn=*/false);
    cuda::project(args, context);
    color_splats(args, settings.color_pass, args.out.counts, context);
    return args.out;
  }

  /// `counts`: ColorCudaArgs.
  void color_splats(const ProjectCudaArgs& args, ColorPass* pass, ViewCounts* counts, const LaunchContext& context) {
    const std::int64_t n = args.gaussians.n_gaussians;
    if (pass == nullptr || n == 0) return;
    pass->color({args.gaussians, args.view.center, args.sh_degree, args.out, counts}, context);
    const bool is_drawn = args.out.list_growth != nullptr;
    if (is_drawn && n_rows_ > n_first_rows_) copy_second_colors(args.out, n, context);
  }

  /// Waits for the counts of the lists, after calling `meanwhile`. `widest`: what rows are, in errors.
  void bin_view(
      const ProjectOutputs& projected, const RenderSettings& settings, const char* widest, const LaunchContext& context,
      const std::function<void()>& meanwhile = [] {}) {
    number_lists(projected, state_.grid.n_tiles(), bin_buffers_, counts_reader_.begin(), context);
    counts_reader_.mark(context);
    meanwhile();
    begin_stage(state_.settings.stages, Stage::kBin);
    const ViewCounts counts = counts_reader_.poll();
    if (counts.n_pairs > kIndexMax) {
      throw NumericError(too_many_pairs(counts.n_pairs,
                                        widest_gaussian(projected, n_rows_, state_.grid, settings.culling, context),
                                        state_.grid.n_tiles(), widest));
    }
    state_.n_splats = counts.n_splats + counts.n_second;
    cut_ = list_cut(counts, context.n_multiprocessors);
    const bool keep_slots = settings.deterministic && settings.keep_for_backward;
    binned_ = bin({projected, n_rows_, counts, state_.grid, settings.culling, keep_slots}, bin_buffers_, pass_scratch_,
                  context);
  }

  /// From the lists to the images.
  void draw(const ProjectOutputs& projected, const RenderSettings& settings, const ImageArrays& out,
            const LaunchContext& context) {
    state_.rendered = out;
    if (state_.settings.inverse_depth) invert_depths({n_rows_, projected.radii, projected.splats, nullptr}, context);

    begin_stage(state_.settings.stages, Stage::kBlendForward);
    parts_ = {};
    if (settings.keep_for_backward) {
      parts_.color = blended_.part_color.resize(n_bucket_pixels(), context);
      if (settings.depth_gradient) parts_.depth = blended_.part_depth.resize(n_bucket_pixels(), context);
      reserve_for_backward(context);
    }
    const std::int64_t n_pixels = std::int64_t{state_.view.width} * state_.view.height;
    blended_.transmittance.resize(n_pixels, context);
    blended_.last_ids.resize(n_pixels, context);
    blend_forward(settings.kernel, context);
    end_stage(state_.settings.stages);
  }

  /// Takes the memory that the backward pass needs while this pass can still be repeated.
  void reserve_for_backward(const LaunchContext& context) {
    sums_.splats.resize(n_rows_, context);
    if (state_.settings.deterministic) sums_.pairs.resize(binned_.bins.n_pairs, context);
    if (state_.settings.camera_gradient) {
      sums_.camera_parts.resize(kCameraGradientParts * kCameraGradients, context);
      sums_.camera.resize(kCameraGradients, context);
    }
  }

  TileLists lists() const { return {rows_.splats.data(), rows_.extents.data(), binned_.bins, state_.grid}; }
  BlendForwardArgs blend_args() const {
    return {lists(), state_.settings.background, state_.rendered, blended_.transmittance.data(),
            blended_.last_ids.data()};
  }

  void blend_forward(ForwardKernel kernel, const LaunchContext& context) {
    BlendForwardCudaArgs args{blend_args(), binned_.buckets, binned_.tiles_by_length, cut_, parts_};
    forward_scratch_.allocate(kernel, args, pass_scratch_, context);
    kForwardLaunches[static_cast<std::size_t>(kernel)](args, context);
    stored_parts_ = parts_after(kernel, args);
  }

  /// `sums`: [rows] out.
  void blend_backward(BackwardKernel kernel, const ImageGradArrays& grad, SplatGradSum* sums,
                      const LaunchContext& context) {
    B3DGS_CHECK(parts_.color != nullptr, "backward() after a forward() without keep_for_backward");
    B3DGS_CHECK(grad.depth == nullptr || parts_.depth != nullptr,
                "gradient with respect to depth after a forward() without depth_gradient");
    BlendBackwardCudaArgs args{};
    args.blend = {blend_args(), grad, nullptr};
    args.buckets = binned_.buckets;
    args.parts = stored_parts_;
    args.splat_grads = sums;
    if (sums != sums_.splats.data() || !std::exchange(sums_.are_zero, false)) zero(sums, n_rows_, context);
    if (state_.settings.deterministic && binned_.bins.n_pairs > 0) {
      args.pair_grads = sums_.pairs.resize(binned_.bins.n_pairs, context);
      zero(args.pair_grads, binned_.bins.n_pairs, context);
    }
    if (kernel == BackwardKernel::kPerBucket && has_many_parts(binned_.counts)) {
      pass_scratch_.allocate(context,
                             [&](ScratchArrays& arrays) { args.behind = arrays.take<float>(n_bucket_pixels()); });
      args.tiles_by_length = binned_.tiles_by_length;
      args.n_long_lists = static_cast<std::int32_t>(binned_.counts.n_long_lists);
    }
    kBackwardLaunches[static_cast<std::size_t>(kernel)](args, context);
    if (args.pair_grads != nullptr) {
      sum_splat_grads({n_rows_, binned_.bins.slot_offsets, args.pair_grads, sums}, context);
    }
    if (state_.settings.inverse_depth && grad.depth != nullptr) {
      invert_depth_gradients({n_rows_, rows_.radii.data(), rows_.splats.data(), sums}, context);
    }
  }

  /// Of a panorama: to the first rows, which are all that passes over Gaussians read.
  template <class Sums>
  void join_second_splats(Sums* sums, const LaunchContext& context) {
    if (n_rows_ > n_first_rows_) join_second({n_first_rows_, rows_.radii.data(), sums}, context);
  }

  /// Of forward_splats(): sum_all(sums) writes the sums of all rows; `out` receives those of the rows that it was
  /// given, with those of their second splats.
  template <class Sums, class SumAll>
  void sum_rows(Sums* out, const LaunchContext& context, SumAll&& sum_all) {
    if (n_rows_ == n_first_rows_) return sum_all(out);
    static_assert(sizeof(Sums) <= sizeof(SplatGradSum), "fits into a splat's gradient");
    auto* const sums = reinterpret_cast<Sums*>(sums_.splats.resize(n_rows_, context));
    sum_all(sums);
    join_second_splats(sums, context);
    B3DGS_CUDA_CHECK(cudaMemcpyAsync(out, sums, static_cast<std::size_t>(n_first_rows_) * sizeof(Sums),
                                     cudaMemcpyDeviceToDevice, context.stream));
  }

  /// The backward blend and, if wanted, the gradient with respect to the camera. Returns the arguments of
  /// project_backward() without the gradient arrays.
  ProjectBackwardCudaArgs blend_and_prepare(const GaussianArrays& gaussians, const ImageGradArrays& grad,
                                            const LaunchContext& context) {
    state_.check_same(gaussians);
    begin_stage(state_.settings.stages, Stage::kBlendBackward);
    blend_backward(state_.settings.backward_kernel, grad, sums_.splats.data(), context);
    join_second_splats(sums_.splats.data(), context);
    end_stage(state_.settings.stages);
    ProjectBackwardCudaArgs args{gaussians,          state_.view,         state_.settings.sh_degree,
                                 rows_.radii.data(), rows_.splats.data(), sums_.splats.data()};
    args.antialiasing = state_.settings.antialiasing;
    state_.has_camera_gradient = state_.settings.camera_gradient;
    if (state_.settings.camera_gradient) {
      begin_stage(state_.settings.stages, Stage::kProjectBackward);
      cuda::camera_gradient(
          {args, bin_buffers_.seen.data(), state_.n_splats, sums_.camera_parts.data(), sums_.camera.data()}, context);
      end_stage(state_.settings.stages);
    }
    return args;
  }

  /// `sums`: [rows] out.
  void score_rows(const float* error, ScoreSums* sums, bool wants_weights, const LaunchContext& context) {
    zero(sums, n_rows_, context);
    cuda::score({lists(), error, sums}, binned_.tiles_by_length, wants_weights, context);
  }

  template <class Row>
  static void zero(Row* rows, std::int64_t n, const LaunchContext& context) {
    B3DGS_CUDA_CHECK(cudaMemsetAsync(rows, 0, static_cast<std::size_t>(n) * sizeof(Row), context.stream));
  }

  /// At least one, so that there is memory for parts, which says that they were kept.
  std::int64_t n_bucket_pixels() const { return std::max<std::int64_t>(binned_.buckets.n, 1) * kCudaTilePixels; }

  template <class Visit>
  void visit_buffers(Visit&& visit) {
    visit(rows_.splats), visit(rows_.extents), visit(rows_.radii), visit(blended_.last_ids), visit(rows_.list_growth);
    visit(sums_.n_records), visit(rows_.counts), visit(blended_.part_color), visit(blended_.part_depth),
        visit(blended_.transmittance), visit(sums_.splats);
    visit(sums_.pairs), visit(pass_scratch_), visit(sums_.camera_parts), visit(sums_.camera);
    forward_scratch_.visit_buffers(visit);
    bin_buffers_.visit_buffers(visit);
  }

  std::function<LaunchContext()> context_;
  /// Of the last projection.
  struct {
    DeviceBuffer<Splat> splats;
    DeviceBuffer<Vec2f> extents;
    DeviceBuffer<std::int32_t> radii, list_growth;
    DeviceBuffer<ViewCounts> counts;
  } rows_;
  /// What a forward blend leaves.
  struct {
    DeviceBuffer<std::int32_t> last_ids;
    DeviceBuffer<float4> part_color;
    DeviceBuffer<float> part_depth, transmittance;
  } blended_;
  /// Sums of the backward pass.
  struct {
    DeviceBuffer<SplatGradSum> splats, pairs;
    DeviceBuffer<double> camera_parts, camera;
    DeviceBuffer<std::int32_t> n_records;
    bool are_zero = false;  // rows of `splats` that have a splat, as the projection wrote them
  } sums_;
  /// Projections that were queued.
  struct {
    std::vector<std::unique_ptr<PinnedValue<ViewCounts>>> counts;
    std::size_t n = 0;
    StreamMark copied;
  } queue_;
  BinBuffers bin_buffers_;
  ForwardScratch forward_scratch_;
  PassScratch pass_scratch_;
  CountsReader counts_reader_, colored_reader_;
  SideStream side_;

  std::int64_t n_rows_ = 0, n_first_rows_ = 0;  // of the last projection: all, and without second splats
  // Of the last forward pass:
  ListCut cut_{};
  BinnedView binned_{};
  BucketParts parts_{};         // memory for the bucket parts
  BucketParts stored_parts_{};  // what the last blend stored there
};

}  // namespace

std::unique_ptr<RasterizerBackend> make_rasterizer(std::function<LaunchContext()> context) {
  return std::make_unique<CudaBackend>(std::move(context));
}

}  // namespace b3dgs::cuda
