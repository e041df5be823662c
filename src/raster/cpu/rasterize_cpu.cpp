// Runs the CPU passes in order and owns the memory between them.

#include <algorithm>
#include <array>
#include <memory>

#include "core/parallel.h"
#include "raster/checks.h"
#include "raster/cpu/pack_splats.h"
#include "raster/cpu/passes.h"
#include "raster/math/blend.h"
#include "raster/math/pixel_outputs.h"
#include "raster/math/project_splat.h"
#include "raster/math/tiling.h"
#include "raster/rasterizer_backend.h"

namespace b3dgs::cpu {
namespace {

constexpr std::int64_t kGrain = 4096;

/// Indexed by ForwardKernel.
constexpr std::array kForwardPasses{
#define B3DGS_ROW(kernel, id, name, is_balanced, summary) &blend_forward_##id,
    B3DGS_FORWARD_KERNELS(B3DGS_ROW)
#undef B3DGS_ROW
};

TileGrid checked_grid(const CameraView& view, const TileShape& tile) {
  B3DGS_CHECK(tile.width > 0 && tile.width <= kMaxTileSide && tile.height > 0 && tile.height <= kMaxTileSide,
              "tile is ", tile.width, " x ", tile.height, " px, expected sides of 1 to ", kMaxTileSide);
  return make_tile_grid(view.width, view.height, tile);
}

/// Replaces project() for splats that were projected elsewhere, and numbers them row by row as if they were Gaussians.
/// Returns M. Not in project_cpu.cpp, so that the compiler still inlines all of projection there.
std::int64_t load_rows(const SplatRows& rows, const ProjectArgs& args) {
  const int n_each = splats_per_gaussian(args.view.lens);
  const auto add_row = [&](std::int64_t m, PackedSplats& out) {
    ProjectedGaussian first;
    first.radius = args.out.radii[m] = rows.radii[m];
    first.extent = rows.extents[m];
    first.splat = rows.splats[m];
    first.splat.gaussian = static_cast<std::int32_t>(m);
    out.add(first);
    if (n_each == 2) out.add_second(args, first);
    return true;
  };
  return pack_splats(rows.n_splats, n_each, args.out, add_row).n;
}

class CpuBackend final : public RasterizerBackend {
 public:
  void forward(const GaussianArrays& gaussians, const CameraView& view, const RenderSettings& settings,
               const ImageArrays& out) override {
    const SplatCounts counts = project_gaussians(gaussians, view, settings, /*is_drawn=*/true);
    draw(counts.n_first + counts.n_second, "Gaussian", out);
    state_.n_gaussians = gaussians.n_gaussians;
  }

  void backward(const GaussianArrays& gaussians, const ImageGradArrays& grad, const GaussianGradArrays& out) override {
    state_.check_same(gaussians);
    const PairSums<SplatGrad> sums = blend_backward(grad);
    const ProjectBackwardArgs args = project_args(gaussians);
    project_backward(args, sums, out);
    finish_backward(args, sums);
  }

  void backward_to_splats(const GaussianArrays& gaussians, const ImageGradArrays& grad,
                          const SplatRecordArrays& out) override {
    state_.check_same(gaussians);
    const PairSums<SplatGrad> sums = blend_backward(grad);
    keep_splat_records(sums, state_.n_gaussians, out);
    finish_backward(project_args(gaussians), sums);
  }

  std::int64_t project(const GaussianArrays& gaussians, const CameraView& view, const RenderSettings& settings,
                       const SplatAllocator& allocate) override {
    const SplatCounts counts = project_gaussians(gaussians, view, settings, /*is_drawn=*/false);
    const SplatRowArrays out = allocate(counts.n_first);
    parallel_each(counts.n_first, kGrain, [&](std::int64_t m) {
      out.splats[m] = splats_.data()[m];
      out.extents[m] = extents_.data()[m];
      out.radii[m] = radii_.data()[out.splats[m].gaussian];
    });
    end_stage(state_.settings.stages);
    return counts.n_second;
  }

  void forward_splats(const SplatRows& rows, const CameraView& view, const RenderSettings& settings,
                      const ImageArrays& out) override {
    check_splat_args(rows.n_splats, view, settings);
    draw(load_rows(rows, begin(rows.n_splats, view, settings, /*is_drawn=*/true)), "the Gaussian of splat", out);
    state_.n_given_rows = rows.n_splats;
  }

  void backward_splats(const ImageGradArrays& grad, SplatGradSum* out) override {
    state_.check_rows("backward_splats()");
    blend_backward(grad).visit_gaussians([&](std::int64_t m, const SplatGrad& sum) {
      out[splats_.data()[m].gaussian] = {sum, {0, 0}};
    });
    end_stage(state_.settings.stages);
  }

  void score(const float* error, const ScoreArrays& out) override {
    state_.check_gaussians("score()");
    score_pairs(error).visit_gaussians(
        [&](std::int64_t m, const ScoreSums& sum) { b3dgs::add_scores(sum, out, splats_.data()[m].gaussian); });
  }

  void score_splats(const float* error, ScoreSums* out) override {
    state_.check_rows("score_splats()");
    score_pairs(error).visit_gaussians(
        [&](std::int64_t m, const ScoreSums& sum) { out[splats_.data()[m].gaussian] = sum; });
  }

  void geometry(const GaussianArrays& gaussians, DepthKind kind, const GeometryArrays& out) override {
    state_.check_same(gaussians, "geometry()");
    PlaneRow* const planes = planes_.resize(state_.n_splats);
    splat_planes({gaussians, state_.view, state_.settings.antialiasing, kind}, state_.n_splats, splats_.data(), planes);
    cpu::geometry({lists(), planes, kind, out});
  }

  void reblend(ForwardKernel kernel) override {
    state_.check_view("reblend()");
    state_.check_family(kernel);
    kForwardPasses[static_cast<std::size_t>(kernel)](blend_args());
  }

  /// Scalar code, because training calls this only for its statistics.
  void count_load(std::int32_t* processed, std::int32_t* contributing) const override {
    state_.check_view("count_load()");
    const TileGrid& grid = state_.grid;
    parallel_pool(grid.n_tiles(), [&](std::int64_t tile, int) {
      const Rect rect = tile_pixels(grid, static_cast<std::int32_t>(tile));
      for (std::int32_t y = rect.y_begin; y < rect.y_end; ++y) {
        for (std::int32_t x = rect.x_begin; x < rect.x_end; ++x) {
          PixelLoad load;
          for (std::int64_t i = bins_.tile_offsets[tile]; i < bins_.tile_offsets[tile + 1]; ++i) {
            const auto shape = splat_shape<float>(splats_.data()[bins_.splat_ids[i]]);
            if (!count_entry(load, shape, static_cast<float>(x) + 0.5f, static_cast<float>(y) + 0.5f)) break;
          }
          processed[std::int64_t{y} * grid.image_width + x] = load.processed;
          contributing[std::int64_t{y} * grid.image_width + x] = load.contributing;
        }
      }
    });
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
  /// Returns the arguments of a projection of n Gaussians, without the Gaussians.
  ProjectArgs begin(std::int64_t n, const CameraView& view, const RenderSettings& settings, bool is_drawn) {
    state_.begin_view(view, checked_grid(view, settings.tile_shape()), settings);
    begin_stage(settings.stages, Stage::kProject);
    const std::int64_t n_most = is_drawn ? splats_per_gaussian(view.lens) * n : n;
    const SplatRowArrays out{splats_.resize(n_most), extents_.resize(n_most), radii_.resize(n)};
    return {{}, view, settings, state_.grid, out, is_drawn};
  }

  SplatCounts project_gaussians(const GaussianArrays& gaussians, const CameraView& view, const RenderSettings& settings,
                                bool is_drawn) {
    check_render_args(gaussians, view, settings);
    B3DGS_CHECK(settings.color_pass == nullptr, "a ColorPass needs a GPU");
    ProjectArgs args = begin(gaussians.n_gaussians, view, settings, is_drawn);
    args.gaussians = gaussians;
    return cpu::project(args);
  }

  /// Renders images from the splats.
  void draw(std::int64_t n_splats, const char* indexed, const ImageArrays& out) {
    state_.n_splats = n_splats;
    state_.rendered = out;
    begin_stage(state_.settings.stages, Stage::kBin);
    bins_ =
        bin({splats_.data(), extents_.data(), radii_.data(), n_splats, state_.grid, state_.settings.culling, indexed},
            bin_buffers_);
    if (state_.settings.inverse_depth) {
      parallel_each(n_splats, kGrain, [&](std::int64_t m) { invert_depth(splats_.data()[m]); });
    }
    begin_stage(state_.settings.stages, Stage::kBlendForward);
    const std::int64_t n_pixels = std::int64_t{state_.view.width} * state_.view.height;
    transmittance_.resize(n_pixels);
    last_ids_.resize(n_pixels);
    run_forward_blend([&](ForwardKernel kernel) { kForwardPasses[static_cast<std::size_t>(kernel)](blend_args()); });
    end_stage(state_.settings.stages);
  }

  TileLists lists() const { return {splats_.data(), extents_.data(), bins_, state_.grid}; }
  BlendForwardArgs blend_args() const {
    return {lists(), state_.settings.background, state_.rendered, transmittance_.data(), last_ids_.data()};
  }
  ProjectBackwardArgs project_args(const GaussianArrays& gaussians) const {
    return {gaussians, state_.view, state_.settings.sh_degree, state_.settings.antialiasing};
  }

  /// Runs the backward blend, then begins the stage of the backward projection.
  PairSums<SplatGrad> blend_backward(const ImageGradArrays& grad) {
    begin_stage(state_.settings.stages, Stage::kBlendBackward);
    SplatGrad* const pairs = pair_grads_.resize(bins_.n_pairs);
    cpu::blend_backward({blend_args(), grad, pairs});
    if (state_.settings.inverse_depth) {
      parallel_each(state_.n_splats, kGrain, [&](std::int64_t m) {
        for (std::int64_t slot = bins_.slot_offsets[m]; slot < bins_.slot_offsets[m + 1]; ++slot) {
          pairs[slot].depth = depth_gradient(splats_.data()[m], pairs[slot].depth);
        }
      });
    }
    begin_stage(state_.settings.stages, Stage::kProjectBackward);
    return {splats_.data(), state_.n_splats, bins_.slot_offsets, pairs};
  }

  void finish_backward(const ProjectBackwardArgs& args, const PairSums<SplatGrad>& sums) {
    state_.has_camera_gradient = state_.settings.camera_gradient;
    if (state_.settings.camera_gradient) cpu::camera_gradient(args, sums, camera_gradients_.data());
    end_stage(state_.settings.stages);
  }

  /// Computes the scores of the pairs, in the memory of the gradients.
  PairSums<ScoreSums> score_pairs(const float* error) {
    static_assert(sizeof(ScoreSums) <= sizeof(SplatGrad) && alignof(ScoreSums) <= 64, "fits into a pair's gradient");
    auto* const pairs = reinterpret_cast<ScoreSums*>(pair_grads_.resize(bins_.n_pairs));
    cpu::score({lists(), error, pairs});
    return {splats_.data(), state_.n_splats, bins_.slot_offsets, pairs};
  }

  Buffer<Splat> splats_;
  Buffer<Vec2f> extents_;
  Buffer<std::int32_t> radii_, last_ids_;
  Buffer<float> transmittance_;
  Buffer<SplatGrad> pair_grads_;
  Buffer<PlaneRow> planes_;
  BinBuffers bin_buffers_;
  BinnedSplats bins_{};
  std::array<double, kCameraGradients> camera_gradients_{};  // of the last backward pass
};

}  // namespace

std::unique_ptr<RasterizerBackend> make_rasterizer() {
  return std::make_unique<CpuBackend>();
}

}  // namespace b3dgs::cpu
