// Runs the passes in order and owns the memory between them.

#include <algorithm>
#include <array>
#include <memory>

#include "core/parallel.h"
#include "raster/checks.h"
#include "raster/cpu/passes.h"
#include "raster/math/pixel_load.h"
#include "raster/math/project_splat.h"
#include "raster/math/tiling.h"
#include "raster/rasterizer_backend.h"

namespace b3dgs::cpu {

void blend_forward(ForwardKernel kernel, const BlendForwardArgs& args) {
  switch (kernel) {
#define B3DGS_ROW(kernel, id, name, is_balanced, summary) \
  case ForwardKernel::kernel:                             \
    return blend_forward_##id(args);
    B3DGS_FORWARD_KERNELS(B3DGS_ROW)
#undef B3DGS_ROW
  }
}

namespace {

constexpr std::int64_t kGrain = 4096;

void invert_depths(Splat* splats, std::int64_t n_splats) {
  parallel_each(n_splats, kGrain, [&](std::int64_t m) { invert_depth(splats[m]); });
}

/// Of every pair of each splat.
void invert_depth_gradients(const Splat* splats, std::int64_t n_splats, const std::int64_t* slot_offsets,
                            SplatGrad* pair_grads) {
  parallel_each(n_splats, kGrain, [&](std::int64_t m) {
    for (std::int64_t slot = slot_offsets[m]; slot < slot_offsets[m + 1]; ++slot) {
      pair_grads[slot].depth = depth_gradient(splats[m], pair_grads[slot].depth);
    }
  });
}

TileGrid checked_grid(const CameraView& view, const TileShape& tile) {
  B3DGS_CHECK(tile.width > 0 && tile.width <= kMaxTileSide && tile.height > 0 && tile.height <= kMaxTileSide,
              "tile is ", tile.width, " x ", tile.height, " px, expected sides of 1 to ", kMaxTileSide);
  return make_tile_grid(view.width, view.height, tile);
}

class CpuBackend final : public RasterizerBackend {
 public:
  void forward(const GaussianArrays& gaussians, const CameraView& view, const RenderSettings& settings,
               const ImageArrays& out) override {
    const SplatCounts counts = cpu::project(begin_gaussians(gaussians, view, settings, /*is_drawn=*/true));
    state_.n_splats = counts.n_first + counts.n_second;
    draw(settings, out);
    state_.n_gaussians = gaussians.n_gaussians;
  }

  void backward(const GaussianArrays& gaussians, const ImageGradArrays& grad, const GaussianGradArrays& out) override {
    state_.check_same(gaussians);
    blend_backward(grad);
    begin_stage(state_.settings.stages, Stage::kProjectBackward);
    const ProjectBackwardArgs args = project_args(gaussians, out);
    project_backward(args);
    project_camera_gradient(args);
    end_stage(state_.settings.stages);
  }

  void backward_to_splats(const GaussianArrays& gaussians, const ImageGradArrays& grad,
                          const SplatRecordArrays& out) override {
    state_.check_same(gaussians);
    blend_backward(grad);
    begin_stage(state_.settings.stages, Stage::kProjectBackward);
    keep_splat_records(
        {state_.n_gaussians, state_.n_splats, splats_.data(), bins_.slot_offsets, pair_grads_.data(), out});
    project_camera_gradient(project_args(gaussians, {}));
    end_stage(state_.settings.stages);
  }

  std::int64_t project(const GaussianArrays& gaussians, const CameraView& view, const RenderSettings& settings,
                       const SplatAllocator& allocate) override {
    const SplatCounts counts = cpu::project(begin_gaussians(gaussians, view, settings, /*is_drawn=*/false));
    const SplatRowArrays out = allocate(counts.n_first);
    parallel_chunks(counts.n_first, kGrain, [&](std::int64_t begin, std::int64_t end) {
      std::copy(splats_.data() + begin, splats_.data() + end, out.splats + begin);
      std::copy(extents_.data() + begin, extents_.data() + end, out.extents + begin);
      for (std::int64_t m = begin; m < end; ++m) out.radii[m] = radii_.data()[out.splats[m].gaussian];
    });
    end_stage(state_.settings.stages);
    return counts.n_second;
  }

  void forward_splats(const SplatRows& rows, const CameraView& view, const RenderSettings& settings,
                      const ImageArrays& out) override {
    const std::int64_t n = rows.n_splats;
    check_splat_args(n, view, settings);
    state_.n_splats = load_rows(rows, begin(n, view, settings, /*is_drawn=*/true));
    PairLimit limit;
    limit.indexed = "the Gaussian of splat";
    draw(settings, out, limit);
    row_slots_ = bins_.slot_offsets;
    if (splats_per_gaussian(view.lens) == 2) row_slots_ = find_row_slots(n);
    state_.n_given_rows = n;
  }

  void backward_splats(const ImageGradArrays& grad, SplatGradSum* out) override {
    state_.check_rows("backward_splats()");
    blend_backward(grad);
    begin_stage(state_.settings.stages, Stage::kProjectBackward);
    sum_splat_grads({state_.n_given_rows, row_slots_, pair_grads_.data(), out});
    end_stage(state_.settings.stages);
  }

  void score(const float* error, const ScoreArrays& out) override {
    state_.check_gaussians("score()");
    add_scores({splats_.data(), state_.n_splats, bins_.slot_offsets, score_pairs(error), out});
  }

  void score_splats(const float* error, ScoreSums* out) override {
    state_.check_rows("score_splats()");
    sum_scores({state_.n_given_rows, row_slots_, score_pairs(error), out});
  }

  void reblend(ForwardKernel kernel) override {
    state_.check_view("reblend()");
    blend_forward(kernel, blend_args());
  }

  void count_load(std::int32_t* processed, std::int32_t* contributing) const override {
    state_.check_view("count_load()");
    cpu::count_load({splats_.data(), bins_, state_.grid, processed, contributing});
  }

  const double* camera_gradient() const override {
    check_camera_gradient();
    return camera_gradients_.data();
  }

  const std::int32_t* radii() const override { return radii_.data(); }
  const std::int32_t* last_ids() const override { return last_ids_.data(); }
  const Splat* splats() const override { return splats_.data(); }
  BinnedSplats bins() const override { return bins_; }

 private:
  /// Returns the arguments of a projection of n Gaussians, without these.
  ProjectArgs begin(std::int64_t n, const CameraView& view, const RenderSettings& settings, bool is_drawn) {
    state_.begin_view(view, checked_grid(view, settings.tile), settings);
    begin_stage(state_.settings.stages, Stage::kProject);
    const std::int64_t n_most = is_drawn ? splats_per_gaussian(view.lens) * n : n;
    return {{},
            view,
            settings.sh_degree,
            settings.near_plane,
            settings.culling,
            state_.grid,
            splats_.resize(n_most),
            extents_.resize(n_most),
            radii_.resize(n),
            settings.antialiasing,
            is_drawn};
  }

  ProjectArgs begin_gaussians(const GaussianArrays& gaussians, const CameraView& view, const RenderSettings& settings,
                              bool is_drawn) {
    check_render_args(gaussians, view, settings);
    B3DGS_CHECK(settings.color_pass == nullptr, "a ColorPass needs a GPU");
    ProjectArgs args = begin(gaussians.n_gaussians, view, settings, is_drawn);
    args.gaussians = gaussians;
    return args;
  }

  /// Of a panorama: the first slot of each row of forward_splats(), and the end. The slots of its second splat follow
  /// those of the first.
  const std::int64_t* find_row_slots(std::int64_t n_rows) {
    std::int64_t* const row_slots = row_slot_room_.resize(n_rows + 1);
    parallel_each(state_.n_splats, kGrain, [&](std::int64_t m) {
      if (!is_across_the_seam(splats_.data(), m)) row_slots[splats_.data()[m].gaussian] = bins_.slot_offsets[m];
    });
    row_slots[n_rows] = bins_.n_pairs;
    return row_slots;
  }

  /// From the splats to the images.
  void draw(const RenderSettings& settings, const ImageArrays& out, const PairLimit& limit = {}) {
    state_.rendered = out;
    begin_stage(state_.settings.stages, Stage::kBin);
    bins_ = bin({splats_.data(), extents_.data(), radii_.data(), state_.n_splats, state_.grid, settings.culling},
                bin_buffers_, limit);
    if (state_.settings.inverse_depth) invert_depths(splats_.data(), state_.n_splats);
    begin_stage(state_.settings.stages, Stage::kBlendForward);
    const std::int64_t n_pixels = std::int64_t{state_.view.width} * state_.view.height;
    transmittance_.resize(n_pixels);
    last_ids_.resize(n_pixels);
    blend_forward(settings.kernel, blend_args());
    end_stage(state_.settings.stages);
  }

  BlendForwardArgs blend_args() const {
    return {splats_.data(),  extents_.data(),       bins_,           state_.grid, state_.settings.background,
            state_.rendered, transmittance_.data(), last_ids_.data()};
  }

  /// The gradients of the pairs.
  void blend_backward(const ImageGradArrays& grad) {
    begin_stage(state_.settings.stages, Stage::kBlendBackward);
    SplatGrad* const pairs = pair_grads_.resize(bins_.n_pairs);
    cpu::blend_backward({splats_.data(), extents_.data(), bins_, state_.grid, state_.settings.background,
                         state_.rendered, transmittance_.data(), last_ids_.data(), grad, pairs});
    if (state_.settings.inverse_depth)
      invert_depth_gradients(splats_.data(), state_.n_splats, bins_.slot_offsets, pairs);
  }

  ProjectBackwardArgs project_args(const GaussianArrays& gaussians, const GaussianGradArrays& out) const {
    return {gaussians,
            state_.view,
            state_.settings.sh_degree,
            splats_.data(),
            state_.n_splats,
            bins_.slot_offsets,
            pair_grads_.data(),
            out,
            state_.settings.antialiasing};
  }

  void project_camera_gradient(const ProjectBackwardArgs& args) {
    if (state_.settings.camera_gradient) cpu::camera_gradient(args, camera_gradients_.data());
    state_.has_camera_gradient = state_.settings.camera_gradient;
  }

  /// The scores of the pairs, in memory of the gradients.
  ScoreSums* score_pairs(const float* error) {
    static_assert(sizeof(ScoreSums) <= sizeof(SplatGrad) && alignof(ScoreSums) <= 64, "fits into a pair's gradient");
    auto* const sums = reinterpret_cast<ScoreSums*>(pair_grads_.resize(bins_.n_pairs));
    cpu::score({splats_.data(), extents_.data(), bins_, state_.grid, error, sums});
    return sums;
  }

  Buffer<Splat> splats_;
  Buffer<Vec2f> extents_;
  Buffer<std::int32_t> radii_, last_ids_;
  Buffer<float> transmittance_;
  Buffer<SplatGrad> pair_grads_;
  BinBuffers bin_buffers_;
  BinnedSplats bins_{};
  const std::int64_t* row_slots_ = nullptr;  // [rows + 1] of forward_splats()
  Buffer<std::int64_t> row_slot_room_;
  std::array<double, kCameraGradients> camera_gradients_{};  // of the last backward pass
};

}  // namespace

std::unique_ptr<RasterizerBackend> make_rasterizer() {
  return std::make_unique<CpuBackend>();
}

namespace {

// Load counting: threads take tiles from an atomic counter and count one pixel at a time. Training calls this only for
// its statistics, so scalar code is fast enough.

PixelLoad count_pixel(const CountLoadArgs& args, std::int32_t tile, float center_x, float center_y) {
  PixelLoad load;
  for (std::int64_t i = args.bins.tile_offsets[tile]; i < args.bins.tile_offsets[tile + 1]; ++i) {
    const auto shape = splat_shape<float>(args.splats[args.bins.splat_ids[i]]);
    if (!count_entry(load, shape, center_x, center_y)) break;
  }
  return load;
}

}  // namespace

void count_load(const CountLoadArgs& args) {
  parallel_pool(args.grid.n_tiles(), [&](std::int64_t task, int) {
    const auto tile = static_cast<std::int32_t>(task);
    const Rect rect = tile_pixels(args.grid, tile);
    for (std::int32_t y = rect.y_begin; y < rect.y_end; ++y) {
      for (std::int32_t x = rect.x_begin; x < rect.x_end; ++x) {
        const PixelLoad load = count_pixel(args, tile, static_cast<float>(x) + 0.5f, static_cast<float>(y) + 0.5f);
        const std::int64_t pixel = std::int64_t{y} * args.grid.image_width + x;
        args.processed[pixel] = load.processed;
        args.contributing[pixel] = load.contributing;
      }
    }
  });
}

}  // namespace b3dgs::cpu
