// Runs the CUDA passes in order and owns the memory between them.

#include <algorithm>
#include <functional>
#include <memory>
#include <utility>
#include <vector>

#include "raster/checks.h"
#include "raster/cuda/blend_kernels.h"
#include "raster/cuda/device_buffer.h"
#include "raster/cuda/paper/paper.h"
#include "raster/cuda/passes.h"
#include "raster/cuda/view_counts.h"
#include "raster/math/tiling.h"
#include "raster/rasterizer_backend.h"

namespace b3dgs::cuda {
namespace {

class CudaBackend final : public RasterizerBackend {
 public:
  explicit CudaBackend(std::function<LaunchContext()> context) : context_(std::move(context)) {}

  void forward(const GaussianArrays& gaussians, const CameraView& view, const RenderSettings& settings,
               const ImageArrays& out) override {
    check_render_args(gaussians, view, settings);
    const LaunchContext context = context_();
    // Lists and the colours of a ColorPass do not depend on each other, and neither fills the device. Projection and
    // lists run on the side stream, which has priority, so that lists do not wait for an event.
    const bool has_pass = settings.color_pass != nullptr;
    const LaunchContext lists = has_pass ? side_.fork(context) : context;
    try {
      ProjectCudaArgs args = begin_drawn(gaussians, view, settings, lists);
      sums_.are_zero = settings.keep_for_backward;
      if (sums_.are_zero) args.out.sums = sums_.splats.resize(n_rows_, lists);
      cuda::project(args, lists);
      if (has_pass) side_.join(context);  // the colour pass follows the projection
      count_view(args.out, lists);
      if (has_pass) {
        color_splats(args, colored_reader_.begin(), context);
        colored_reader_.mark(context);
      }
      bin_view(/*widest=*/"Gaussian", lists);
    } catch (...) {
      if (has_pass) side_.join(context);
      throw;
    }
    if (has_pass) side_.join(context);
    if (settings.camera_gradient) list_seen(lists_.projected, n_rows_, bin_buffers_, context);
    draw(out, context);
    if (has_pass) colored_reader_.wait();  // throws if a colour is invalid
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
    keep_splat_records(args, sums_.n_records.resize(1, context), out, context);
    end_stage(state_.settings.stages);
  }

  std::int64_t project(const GaussianArrays& gaussians, const CameraView& view, const RenderSettings& settings,
                       const SplatAllocator& allocate) override {
    const LaunchContext context = context_();
    const ProjectOutputs projected = project_seen(0, gaussians, view, settings, context);
    const SplatCounts counts = wait_for_projections().front();
    copy_seen(projected, bin_buffers_.seen.data(), counts.n_first, allocate(counts.n_first), context);
    end_stage(settings.stages);
    return counts.n_second;
  }

  void queue_projection(std::size_t index, const GaussianArrays& gaussians, const CameraView& view,
                        const RenderSettings& settings, const SplatRowArrays& out, std::int64_t capacity) override {
    const LaunchContext context = context_();
    const ProjectOutputs projected = project_seen(index, gaussians, view, settings, context);
    copy_seen(projected, bin_buffers_.seen.data(), capacity, out, context);
    end_stage(settings.stages);
  }

  std::vector<SplatCounts> wait_for_projections() override {
    if (queue_.n > 0) wait_for(queue_.copied);
    std::vector<SplatCounts> counts(std::exchange(queue_.n, 0));
    for (std::size_t v = 0; v < counts.size(); ++v) {
      const ViewCounts& found = valid(*queue_.counts[v].get());
      counts[v] = {found.n_splats, found.n_second};
    }
    return counts;
  }

  void forward_splats(const SplatRows& rows, const CameraView& view, const RenderSettings& settings,
                      const ImageArrays& out) override {
    check_splat_args(rows.n_splats, view, settings);
    const LaunchContext context = context_();
    const ProjectCudaArgs args = begin_drawn({rows.n_splats}, view, settings, context);
    sums_.are_zero = false;
    load_rows(rows, args, context);
    count_view(args.out, context);
    bin_view(/*widest=*/"the Gaussian of splat", context);
    draw(out, context);
    state_.n_given_rows = rows.n_splats;
  }

  void backward_splats(const ImageGradArrays& grad, SplatGradSum* out) override {
    state_.check_rows("backward_splats()");
    const LaunchContext context = context_();
    begin_stage(state_.settings.stages, Stage::kBlendBackward);
    sum_rows(out, context, [&](SplatGradSum* sums) { blend_backward(grad, sums, context); });
    end_stage(state_.settings.stages);
  }

  void score(const float* error, const ScoreArrays& out) override {
    state_.check_gaussians("score()");
    const LaunchContext context = context_();
    auto* const sums = row_sums<ScoreSums>(context);
    score_rows(error, sums, out.weight_sum != nullptr, context);
    join_second_splats(sums, context);
    add_scores({rows_.splats.data(), state_.n_gaussians, sums, out}, rows_.radii.data(), context);
  }

  void score_splats(const float* error, ScoreSums* out) override {
    state_.check_rows("score_splats()");
    const LaunchContext context = context_();
    sum_rows(out, context, [&](ScoreSums* sums) { score_rows(error, sums, /*wants_weights=*/true, context); });
  }

  void geometry(const GaussianArrays& gaussians, DepthKind kind, const GeometryArrays& out) override {
    state_.check_same(gaussians, "geometry()");
    const LaunchContext context = context_();
    PlaneRow* planes = nullptr;
    assign_scratch(scratch_, context, [&](ScratchArrays& arrays) { planes = arrays.take<PlaneRow>(n_rows_); });
    splat_planes({gaussians, state_.view, state_.settings.antialiasing, kind}, lists_.projected, n_rows_, planes,
                 context);
    cuda::geometry({tile_lists(), planes, kind, out}, lists_.tiles_by_length, context);
  }

  void reblend(ForwardKernel kernel) override {
    state_.check_view("reblend()");
    state_.check_family(kernel);
    blend_forward(kernel, context_());
  }

  void reblend_backward(const ImageGradArrays& grad) override {
    state_.check_view("reblend_backward()");
    sums_.are_zero = false;  // the caller reads all rows
    blend_backward(grad, sums_.splats.data(), context_());
  }

  KernelOccupancy measure_occupancy(ForwardKernel kernel) override {
    state_.check_view("measure_occupancy()");
    state_.check_family(kernel);
    const LaunchContext context = context_();
    return measure_paper(kernel, paper_args(context), context);
  }

  void count_load(std::int32_t* processed, std::int32_t* contributing) const override {
    state_.check_view("count_load()");
    cuda::count_load({tile_lists(), processed, contributing}, context_());
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
  BinnedSplats bins() const override { return lists_.bins(); }

  std::int64_t memory_bytes() override {
    std::int64_t bytes = 0;
    visit_buffers([&](const auto&... buffers) { bytes = (buffers.bytes() + ...); });
    return bytes;
  }
  void release_memory() override {
    state_.forget_view();
    visit_buffers([](auto&... buffers) { (buffers.release(), ...); });
  }

 private:
  /// Begins a view, up to the arguments of its projection. If a ColorPass computes the colours, they are not included,
  /// and color_splats() must follow. A panorama has as many second rows as Gaussians.
  ProjectCudaArgs begin(const GaussianArrays& gaussians, const CameraView& view, const RenderSettings& settings,
                        const LaunchContext& context) {
    n_first_rows_ = gaussians.n_gaussians;
    n_rows_ = n_first_rows_ * splats_per_gaussian(view.lens);
    state_.begin_view(view, make_tile_grid(view.width, view.height, settings.tile_shape()), settings);
    begin_stage(settings.stages, Stage::kProject);
    ProjectCudaArgs args{gaussians, view, settings.sh_degree, settings.near_plane, settings.culling, state_.grid};
    args.out = {rows_.splats.resize(n_rows_, context), rows_.extents.resize(n_rows_, context),
                rows_.radii.resize(n_rows_, context), nullptr, rows_.counts.resize(1, context)};
    args.with_colors = settings.color_pass == nullptr;
    args.antialiasing = settings.antialiasing;
    return args;
  }

  ProjectCudaArgs begin_drawn(const GaussianArrays& gaussians, const CameraView& view, const RenderSettings& settings,
                              const LaunchContext& context) {
    B3DGS_CHECK(!settings.tile, "a GPU has only the tiles of the kernel's family");
    B3DGS_CHECK(!settings.deterministic || !settings.keep_for_backward || is_own(settings),
                "the paper's family has no deterministic gradients");
    ProjectCudaArgs args = begin(gaussians, view, settings, context);
    args.out.list_growth = rows_.list_growth.resize(kCounterStride * (state_.grid.n_tiles() + 1), context);
    return args;
  }

  /// Projects splats with their colours that are not drawn here. Lists the rows that have a splat, and queues the copy
  /// of the counts for wait_for_projections().
  ProjectOutputs project_seen(std::size_t index, const GaussianArrays& gaussians, const CameraView& view,
                              const RenderSettings& settings, const LaunchContext& context) {
    check_render_args(gaussians, view, settings);
    const ProjectCudaArgs args = begin(gaussians, view, settings, context);
    sums_.are_zero = false;
    cuda::project(args, context);
    color_splats(args, args.out.counts, context);
    queue_.n = index + 1;
    if (queue_.counts.size() < queue_.n) queue_.counts.resize(queue_.n);
    B3DGS_CUDA_CHECK(cudaMemcpyAsync(queue_.counts[index].get(), args.out.counts, sizeof(ViewCounts),
                                     cudaMemcpyDeviceToHost, context.stream));
    record(queue_.copied, context.stream);
    list_seen(args.out, n_first_rows_, bin_buffers_, context);
    return args.out;
  }

  /// Runs the ColorPass. `counts`: see ColorCudaArgs.
  void color_splats(const ProjectCudaArgs& args, ViewCounts* counts, const LaunchContext& context) {
    if (args.with_colors || n_first_rows_ == 0) return;
    state_.settings.color_pass->color({args.gaussians, args.view.center, args.sh_degree, args.out, counts}, context);
    const bool is_drawn = args.out.list_growth != nullptr;
    if (is_drawn && n_rows_ > n_first_rows_) copy_second_colors(args.out, n_first_rows_, context);
  }

  /// Runs the first part of binning. bin_view() must follow.
  void count_view(const ProjectOutputs& projected, const LaunchContext& context) {
    lists_ = {projected, n_rows_, state_.grid, state_.settings.culling};
    count_lists(lists_, bin_buffers_, counts_reader_.begin(), context);
    counts_reader_.mark(context);
  }

  /// Runs the second part: waits for the counts of the lists. `widest` names a row in errors.
  void bin_view(const char* widest, const LaunchContext& context) {
    const RenderSettings& settings = state_.settings;
    begin_stage(settings.stages, Stage::kBin);
    lists_.counts = counts_reader_.poll();
    if (lists_.counts.n_pairs > kIndexMax) {
      throw NumericError(
          too_many_pairs(lists_.counts.n_pairs, widest_gaussian(lists_, context), state_.grid.n_tiles(), widest));
    }
    state_.n_splats = lists_.counts.n_splats + lists_.counts.n_second;
    const bool with_slots = settings.deterministic && settings.keep_for_backward;
    bin(lists_, with_slots, bin_buffers_, scratch_, context);
  }

  /// Renders images from the lists.
  void draw(const ImageArrays& out, const LaunchContext& context) {
    const RenderSettings& settings = state_.settings;
    state_.rendered = out;
    if (settings.inverse_depth) invert_depths(n_rows_, rows_.radii.data(), rows_.splats.data(), context);

    begin_stage(settings.stages, Stage::kBlendForward);
    parts_ = {};
    if (settings.keep_for_backward) {
      if (is_own(settings)) {
        parts_.color = blended_.part_color.resize(n_bucket_pixels(), context);
        if (settings.depth_gradient) parts_.depth = blended_.part_depth.resize(n_bucket_pixels(), context);
      }
      // Allocate memory for the backward pass now, while this pass can still be repeated.
      sums_.splats.resize(n_rows_, context);
      if (settings.deterministic) sums_.pairs.resize(lists_.counts.n_pairs, context);
      if (settings.camera_gradient) {
        sums_.camera_parts.resize(kCameraGradientParts * kCameraGradients, context);
        sums_.camera.resize(kCameraGradients, context);
      }
    }
    const std::int64_t n_pixels = std::int64_t{state_.view.width} * state_.view.height;
    blended_.transmittance.resize(n_pixels, context);
    blended_.last_ids.resize(n_pixels, context);
    run_forward_blend([&](ForwardKernel kernel) { blend_forward(kernel, context); });
    end_stage(settings.stages);
  }

  TileLists tile_lists() const { return {rows_.splats.data(), rows_.extents.data(), lists_.bins(), state_.grid}; }
  BlendForwardArgs blend_args() const {
    return {tile_lists(), state_.settings.background, state_.rendered, blended_.transmittance.data(),
            blended_.last_ids.data()};
  }

  static bool is_own(const RenderSettings& settings) { return family_of(settings.kernel) == KernelFamily::kOwn; }

  PaperArgs paper_args(const LaunchContext& context) {
    PaperArgs args{blend_args()};
    assign_scratch(scratch_, context, [&](ScratchArrays& arrays) { args.next_task = arrays.take<std::int32_t>(1); });
    return args;
  }

  void blend_forward(ForwardKernel kernel, const LaunchContext& context) {
    if (family_of(kernel) == KernelFamily::kPaper) return launch_paper(kernel, paper_args(context), context);
    BlendForwardCudaArgs args{};
    args.blend = blend_args();
    args.buckets = lists_.buckets();
    args.tiles_by_length = lists_.tiles_by_length;
    args.parts = parts_;
    if (kernel == ForwardKernel::kSegmented) args.cut = list_cut(lists_.counts, context.n_multiprocessors);
    BucketParts stored = parts_;
    if (args.cut.cuts()) {
      // Not in the scratch memory, which later passes overwrite, because the backward pass needs them.
      Segments& segments = args.segments;
      const std::int64_t n_pixels = args.cut.segments_before(lists_.counts.n_pairs) * kCudaTilePixels;
      segments.first_of_tile = blended_.first_segment_of_tile.resize(state_.grid.n_tiles(), context);
      if (parts_.color != nullptr) segments.fronts = blended_.segment_fronts.resize(n_pixels, context);
      stored.first_segment_of_tile = segments.first_of_tile;
      stored.segment_fronts = segments.fronts;
      stored.segment_buckets_log2 = args.cut.entries_log2 - ListCut::kMinLog2;
    }
    assign_scratch(scratch_, context, [&](ScratchArrays& arrays) { take_forward_scratch(args, arrays); });
    kOwnLaunches[static_cast<std::size_t>(kernel) - static_cast<std::size_t>(ForwardKernel::kSubTile)](args, context);
    stored_parts_ = stored;
  }

  /// Runs the backward blend. `sums`: [rows] out.
  void blend_backward(const ImageGradArrays& grad, SplatGradSum* sums, const LaunchContext& context) {
    const RenderSettings& settings = state_.settings;
    B3DGS_CHECK(settings.keep_for_backward, "backward() after a forward() without keep_for_backward");
    B3DGS_CHECK(grad.depth == nullptr || settings.depth_gradient,
                "gradient with respect to depth after a forward() without depth_gradient");
    BlendBackwardCudaArgs args{};
    args.blend = {blend_args(), grad, nullptr};
    args.buckets = lists_.buckets();
    args.parts = stored_parts_;
    args.splat_grads = sums;
    if (sums != sums_.splats.data() || !std::exchange(sums_.are_zero, false)) zero(sums, n_rows_, context);
    if (settings.deterministic && lists_.counts.n_pairs > 0) {
      args.pair_grads = sums_.pairs.resize(lists_.counts.n_pairs, context);
      zero(args.pair_grads, lists_.counts.n_pairs, context);
    }
    if (is_own(settings) && has_many_parts(lists_.counts)) {
      assign_scratch(scratch_, context,
                     [&](ScratchArrays& arrays) { args.behind = arrays.take<float>(n_bucket_pixels()); });
      args.tiles_by_length = lists_.tiles_by_length;
      args.n_long_lists = static_cast<std::int32_t>(lists_.counts.n_long_lists);
    }
    if (is_own(settings)) {
      launch_backward_per_bucket(args, context);
    } else {
      launch_backward_per_pixel(args, context);
    }
    if (args.pair_grads != nullptr) {
      sum_splat_grads(n_rows_, lists_.slot_offsets, args.pair_grads, sums, context);
    }
    if (settings.inverse_depth && grad.depth != nullptr) {
      invert_depth_gradients(n_rows_, rows_.radii.data(), rows_.splats.data(), sums, context);
    }
  }

  /// Returns memory for the sums of each row, in the memory of the backward pass.
  template <class Sums>
  Sums* row_sums(const LaunchContext& context) {
    static_assert(sizeof(Sums) <= sizeof(SplatGradSum), "fits into a splat's gradient");
    sums_.are_zero = false;
    return reinterpret_cast<Sums*>(sums_.splats.resize(n_rows_, context));
  }

  /// For panoramas: adds the sums of second splats to the first rows, because passes over Gaussians read only those.
  template <class Sums>
  void join_second_splats(Sums* sums, const LaunchContext& context) {
    if (n_rows_ > n_first_rows_) join_second(n_first_rows_, rows_.radii.data(), sums, context);
  }

  /// For forward_splats(): sum_all(sums) writes the sums of all rows. `out` receives the sums of the given rows,
  /// including those of their second splats.
  template <class Sums, class SumAll>
  void sum_rows(Sums* out, const LaunchContext& context, SumAll&& sum_all) {
    if (n_rows_ == n_first_rows_) return sum_all(out);
    auto* const sums = row_sums<Sums>(context);
    sum_all(sums);
    join_second_splats(sums, context);
    B3DGS_CUDA_CHECK(cudaMemcpyAsync(out, sums, static_cast<std::size_t>(n_first_rows_) * sizeof(Sums),
                                     cudaMemcpyDeviceToDevice, context.stream));
  }

  /// Runs the backward blend and, if enabled, the gradient with respect to the camera. Returns the arguments of
  /// project_backward() without the gradient arrays.
  ProjectBackwardCudaArgs blend_and_prepare(const GaussianArrays& gaussians, const ImageGradArrays& grad,
                                            const LaunchContext& context) {
    const RenderSettings& settings = state_.settings;
    state_.check_same(gaussians);
    begin_stage(settings.stages, Stage::kBlendBackward);
    blend_backward(grad, sums_.splats.data(), context);
    join_second_splats(sums_.splats.data(), context);
    end_stage(settings.stages);
    ProjectBackwardCudaArgs args{gaussians,          state_.view,         settings.sh_degree,
                                 rows_.radii.data(), rows_.splats.data(), sums_.splats.data()};
    args.antialiasing = settings.antialiasing;
    state_.has_camera_gradient = settings.camera_gradient;
    if (settings.camera_gradient) {
      begin_stage(settings.stages, Stage::kProjectBackward);
      cuda::camera_gradient(
          {args, bin_buffers_.seen.data(), state_.n_splats, sums_.camera_parts.data(), sums_.camera.data()}, context);
      end_stage(settings.stages);
    }
    return args;
  }

  /// Computes the scores of each row. `sums`: [rows] out.
  void score_rows(const float* error, ScoreSums* sums, bool wants_weights, const LaunchContext& context) {
    zero(sums, n_rows_, context);
    cuda::score({tile_lists(), error, sums}, lists_.tiles_by_length, wants_weights, context);
  }

  template <class Row>
  static void zero(Row* rows, std::int64_t n, const LaunchContext& context) {
    B3DGS_CUDA_CHECK(cudaMemsetAsync(rows, 0, static_cast<std::size_t>(n) * sizeof(Row), context.stream));
  }

  /// Returns the size of arrays with an element for each pixel of each bucket. It is at least one bucket, because a
  /// null pointer to parts means that no parts are stored.
  std::int64_t n_bucket_pixels() const { return std::max<std::int64_t>(lists_.counts.n_buckets, 1) * kCudaTilePixels; }

  template <class Visit>
  void visit_buffers(Visit&& visit) {
    BinBuffers& b = bin_buffers_;
    visit(rows_.splats, rows_.extents, rows_.radii, rows_.list_growth, rows_.counts, blended_.last_ids,
          blended_.first_segment_of_tile, blended_.part_color, blended_.part_depth, blended_.transmittance,
          blended_.segment_fronts, sums_.splats, sums_.pairs, sums_.camera_parts, sums_.camera, sums_.n_records, b.seen,
          b.next_entries, b.first_more_runs, b.tiles_by_length, b.splat_ids, b.tile_of_bucket, b.slot_offsets,
          b.pair_slots, b.tile_offsets, b.bucket_offsets, b.temporary, scratch_);
  }

  std::function<LaunchContext()> context_;
  /// Outputs of the last projection.
  struct {
    DeviceBuffer<Splat> splats;
    DeviceBuffer<Vec2f> extents;
    DeviceBuffer<std::int32_t> radii, list_growth;
    DeviceBuffer<ViewCounts> counts;
  } rows_;
  /// Outputs of a forward blend.
  struct {
    DeviceBuffer<std::int32_t> last_ids, first_segment_of_tile;
    DeviceBuffer<float4> part_color;
    DeviceBuffer<float> part_depth, transmittance, segment_fronts;
  } blended_;
  /// Sums of the backward pass.
  struct {
    DeviceBuffer<SplatGradSum> splats, pairs;
    DeviceBuffer<double> camera_parts, camera;
    DeviceBuffer<std::int32_t> n_records;
    bool are_zero = false;  // projection zeroed the rows of `splats` that have a splat, and nothing was added since
  } sums_;
  /// Queued projections.
  struct {
    std::vector<PinnedCounts> counts;
    std::size_t n = 0;
    Event copied = make_event();
  } queue_;
  BinBuffers bin_buffers_;
  PassScratch scratch_;
  CountsReader counts_reader_, colored_reader_;
  SideStream side_;

  std::int64_t n_rows_ = 0, n_first_rows_ = 0;  // of the last projection: all rows, and rows without second splats
  // Data of the last forward pass.
  ListArgs lists_{};
  BucketParts parts_{};         // all memory for bucket parts
  BucketParts stored_parts_{};  // parts that the last blend stored there
};

}  // namespace

std::unique_ptr<RasterizerBackend> make_rasterizer(std::function<LaunchContext()> context) {
  return std::make_unique<CudaBackend>(std::move(context));
}

}  // namespace b3dgs::cuda
