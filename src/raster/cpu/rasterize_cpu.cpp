// Runs the passes in order and owns the memory between them.

#include "raster/cpu/rasterize_cpu.h"

#include <algorithm>
#include <array>

#include "core/check.h"
#include "core/parallel.h"
#include "raster/args_check.h"
#include "raster/cpu/buffer.h"
#include "raster/cpu/passes.h"
#include "raster/math/inverse_depth.h"
#include "raster/math/tiling.h"
#include "raster/view_state.h"

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
  parallel_chunks(n_splats, kGrain, [&](std::int64_t begin, std::int64_t end) {
    for (std::int64_t m = begin; m < end; ++m) invert_depth(splats[m]);
  });
}

/// Of every pair of each splat.
void invert_depth_gradients(const Splat* splats, std::int64_t n_splats, const std::int64_t* slot_offsets,
                            SplatGrad* pair_grads) {
  parallel_chunks(n_splats, kGrain, [&](std::int64_t begin, std::int64_t end) {
    for (std::int64_t m = begin; m < end; ++m) {
      for (std::int64_t slot = slot_offsets[m]; slot < slot_offsets[m + 1]; ++slot) {
        pair_grads[slot].depth = depth_gradient(splats[m], pair_grads[slot].depth);
      }
    }
  });
}

TileGrid checked_grid(const PinholeView& view, const TileShape& tile) {
  B3DGS_CHECK(tile.width > 0 && tile.width <= kMaxTileSide && tile.height > 0 && tile.height <= kMaxTileSide,
              "tile is ", tile.width, " x ", tile.height, " px, expected sides of 1 to ", kMaxTileSide);
  return make_tile_grid(view.width, view.height, tile);
}

}  // namespace

struct Rasterizer::Impl : ViewState {
  Buffer<Splat> splats;
  Buffer<Vec2f> extents;
  Buffer<std::int32_t> radii, last_ids;
  Buffer<float> transmittance;
  Buffer<SplatGrad> pair_grads;
  BinBuffers bin_buffers;

  BinnedSplats bins{};
  std::array<double, kCameraGradients> camera_gradients{};  // of the last backward pass

  // The parts of a forward pass:
  void project(const GaussianArrays& gaussians, const RenderSettings& settings);
  /// From the splats to the images.
  void draw(const RenderSettings& settings, const ImageArrays& out, const PairLimit& limit = {});

  /// The gradients of the pairs.
  void blend_backward(const ImageGradArrays& grad);
  /// The scores of the pairs, in memory of the gradients.
  ScoreSums* score_pairs(const float* error);
  void project_camera_gradient(const ProjectBackwardArgs& args) {
    if (camera_gradient) cpu::camera_gradient(args, camera_gradients.data());
    has_camera_gradient = camera_gradient;
  }
  ProjectBackwardArgs project_args(const GaussianArrays& gaussians, const GaussianGradArrays& out) const {
    return {gaussians,         view, sh_degree,   splats.data(), n_splats, bins.slot_offsets,
            pair_grads.data(), out,  antialiasing};
  }

  BlendForwardArgs blend_args() const {
    return {splats.data(), extents.data(), bins, grid, background, rendered, transmittance.data(), last_ids.data()};
  }
};

Rasterizer::Rasterizer() : impl_(std::make_unique<Impl>()) {}
Rasterizer::~Rasterizer() = default;
Rasterizer::Rasterizer(Rasterizer&&) noexcept = default;
Rasterizer& Rasterizer::operator=(Rasterizer&&) noexcept = default;

void Rasterizer::Impl::project(const GaussianArrays& gaussians, const RenderSettings& settings) {
  begin_stage(stages, Stage::kProject);
  const std::int64_t n = gaussians.n_gaussians;
  splats.resize(n);
  extents.resize(n);
  radii.resize(n);
  n_splats = cpu::project({gaussians, view, settings.sh_degree, settings.near_plane, settings.culling, grid,
                           splats.data(), extents.data(), radii.data(), settings.antialiasing});
}

void Rasterizer::Impl::draw(const RenderSettings& settings, const ImageArrays& out, const PairLimit& limit) {
  begin_drawing(settings, out);
  begin_stage(stages, Stage::kBin);
  bins = bin({splats.data(), extents.data(), radii.data(), n_splats, grid, settings.culling}, bin_buffers, limit);
  if (inverse_depth) invert_depths(splats.data(), n_splats);
  begin_stage(stages, Stage::kBlendForward);
  const std::int64_t n_pixels = std::int64_t{view.width} * view.height;
  transmittance.resize(n_pixels);
  last_ids.resize(n_pixels);
  blend_forward(settings.kernel, blend_args());
  end_stage(stages);
}

void Rasterizer::forward(const GaussianArrays& gaussians, const PinholeView& view, const RenderSettings& settings,
                         const ImageArrays& out) {
  check_render_args(gaussians, view, settings);
  impl_->begin_view(view, checked_grid(view, settings.tile), settings);
  impl_->project(gaussians, settings);
  impl_->draw(settings, out);
  impl_->n_gaussians = gaussians.n_gaussians;
}

void Rasterizer::project(const GaussianArrays& gaussians, const PinholeView& view, const RenderSettings& settings,
                         const SplatAllocator& allocate) {
  check_render_args(gaussians, view, settings);
  Impl& s = *impl_;
  s.begin_view(view, checked_grid(view, settings.tile), settings);
  s.project(gaussians, settings);
  const SplatRowArrays out = allocate(s.n_splats);
  parallel_chunks(s.n_splats, kGrain, [&](std::int64_t begin, std::int64_t end) {
    std::copy(s.splats.data() + begin, s.splats.data() + end, out.splats + begin);
    std::copy(s.extents.data() + begin, s.extents.data() + end, out.extents + begin);
    for (std::int64_t m = begin; m < end; ++m) out.radii[m] = s.radii.data()[out.splats[m].gaussian];
  });
  end_stage(s.stages);
}

void Rasterizer::forward_splats(const SplatRows& rows, const PinholeView& view, const RenderSettings& settings,
                                const ImageArrays& out) {
  const std::int64_t n = rows.n_splats;
  check_splat_args(n, view, settings);
  Impl& s = *impl_;
  s.begin_view(view, checked_grid(view, settings.tile), settings);
  begin_stage(s.stages, Stage::kProject);
  Splat* const splats = s.splats.resize(n);
  Vec2f* const extents = s.extents.resize(n);
  std::int32_t* const radii = s.radii.resize(n);
  parallel_chunks(n, kGrain, [&](std::int64_t begin, std::int64_t end) {
    std::copy(rows.extents + begin, rows.extents + end, extents + begin);
    std::copy(rows.radii + begin, rows.radii + end, radii + begin);
    for (std::int64_t m = begin; m < end; ++m) {
      splats[m] = rows.splats[m];
      splats[m].gaussian = static_cast<std::int32_t>(m);
    }
  });
  s.n_splats = n;
  PairLimit limit;
  limit.indexed = "the Gaussian of splat";
  s.draw(settings, out, limit);
  s.n_rows = n;
}

void Rasterizer::Impl::blend_backward(const ImageGradArrays& grad) {
  begin_stage(stages, Stage::kBlendBackward);
  SplatGrad* const pairs = pair_grads.resize(bins.n_pairs);
  cpu::blend_backward({splats.data(), extents.data(), bins, grid, background, rendered, transmittance.data(),
                       last_ids.data(), grad, pairs});
  if (inverse_depth) invert_depth_gradients(splats.data(), n_splats, bins.slot_offsets, pairs);
}

void Rasterizer::backward(const GaussianArrays& gaussians, const ImageGradArrays& grad, const GaussianGradArrays& out) {
  Impl& s = *impl_;
  s.check_gaussians(gaussians);
  s.blend_backward(grad);
  begin_stage(s.stages, Stage::kProjectBackward);
  const ProjectBackwardArgs args = s.project_args(gaussians, out);
  project_backward(args);
  s.project_camera_gradient(args);
  end_stage(s.stages);
}

void Rasterizer::backward_to_splats(const GaussianArrays& gaussians, const ImageGradArrays& grad,
                                    const SplatRecordArrays& out) {
  Impl& s = *impl_;
  s.check_gaussians(gaussians);
  s.blend_backward(grad);
  begin_stage(s.stages, Stage::kProjectBackward);
  keep_splat_records({s.n_gaussians, s.n_splats, s.splats.data(), s.bins.slot_offsets, s.pair_grads.data(), out});
  s.project_camera_gradient(s.project_args(gaussians, {}));
  end_stage(s.stages);
}

void Rasterizer::backward_splats(const ImageGradArrays& grad, SplatGradSum* out) {
  Impl& s = *impl_;
  B3DGS_CHECK(s.n_rows >= 0, "backward_splats() before any forward_splats()");
  s.blend_backward(grad);
  begin_stage(s.stages, Stage::kProjectBackward);
  sum_splat_grads({s.n_splats, s.bins.slot_offsets, s.pair_grads.data(), out});
  end_stage(s.stages);
}

void Rasterizer::reblend(ForwardKernel kernel) {
  B3DGS_CHECK(impl_->has_view(), "reblend() before any forward()");
  blend_forward(kernel, impl_->blend_args());
}

void Rasterizer::count_load(std::int32_t* processed, std::int32_t* contributing) const {
  const Impl& s = *impl_;
  B3DGS_CHECK(s.has_view(), "count_load() before any forward()");
  cpu::count_load({s.splats.data(), s.bins, s.grid, processed, contributing});
}

const double* Rasterizer::camera_gradient() const {
  B3DGS_CHECK(impl_->has_camera_gradient,
              "camera_gradient() without a forward() with camera_gradient and its backward()");
  return impl_->camera_gradients.data();
}

ScoreSums* Rasterizer::Impl::score_pairs(const float* error) {
  static_assert(sizeof(ScoreSums) <= sizeof(SplatGrad) && alignof(ScoreSums) <= 64, "fits into a pair's gradient");
  auto* const sums = reinterpret_cast<ScoreSums*>(pair_grads.resize(bins.n_pairs));
  cpu::score({splats.data(), extents.data(), bins, grid, error, sums});
  return sums;
}

void Rasterizer::score(const float* error, const ScoreArrays& out) {
  Impl& s = *impl_;
  B3DGS_CHECK(s.n_gaussians >= 0, "score() before any forward()");
  cpu::add_scores({s.splats.data(), s.n_splats, s.bins.slot_offsets, s.score_pairs(error), out});
}

void Rasterizer::score_splats(const float* error, ScoreSums* out) {
  Impl& s = *impl_;
  B3DGS_CHECK(s.n_rows >= 0, "score_splats() before any forward_splats()");
  cpu::sum_scores({s.n_splats, s.bins.slot_offsets, s.score_pairs(error), out});
}

const std::int32_t* Rasterizer::radii() const {
  return impl_->radii.data();
}
const std::int32_t* Rasterizer::last_ids() const {
  return impl_->last_ids.data();
}
const Splat* Rasterizer::splats() const {
  return impl_->splats.data();
}
BinnedSplats Rasterizer::bins() const {
  return impl_->bins;
}
TileGrid Rasterizer::grid() const {
  return impl_->grid;
}
std::int64_t Rasterizer::n_splats() const {
  return impl_->n_splats;
}

}  // namespace b3dgs::cpu
