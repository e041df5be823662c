// Backward pass and Adam behind one interface, because a GPU fuses parts of them.
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <vector>

#include "raster/stages.h"
#include "raster/torch/rasterizer.h"
#include "train/optimizer/adam.h"
#include "train/optimizer/batch_grad.h"

namespace b3dgs {
namespace cuda {
class DeferredSh;
}

/// The views of a step of several views (--batch), between their backward blends and the step. Keeps the splats of
/// each. Reuses its memory from step to step.
class ViewBatch {
 public:
  int n_views() const { return n_views_; }

  /// Room for one more view of `n_splats` splats.
  void make_room(std::int64_t n_gaussians, std::int64_t n_splats, torch::Device device);

  /// Where the splats of the next view are to be written: see make_room().
  const SplatRecordTensors& room() const { return slots_[static_cast<std::size_t>(n_views_)].splats; }

  /// The splats of this view have been written to room().
  void add(const CameraView& view, const RenderSettings& settings, const RegularizationGrad& regularization);

  /// Arguments for these Gaussians, which must not have changed since the views were rendered. `lenses` is on the host.
  BatchGradArgs grad_args(const GaussianArrays& gaussians) const;

  /// Removes all views.
  void clear() { n_views_ = 0; }

  /// Memory of all views, bytes.
  std::int64_t bytes() const;

 private:
  struct Slot {
    SplatRecordTensors splats;
    torch::Tensor record_room, index_room;
    PinholeView view{};
    RegularizationGrad regularization{};
  };
  std::vector<Slot> slots_;
  std::vector<ViewLens> lenses_;  // of the views
  bool has_lenses_ = false;       // some are no pinholes
  int n_views_ = 0;
  int sh_degree_ = 0;
  bool antialiasing_ = false;
};

/// Adam steps, along the gradients of one view or of several. Each view begins with begin_view(), and is rendered with
/// Rasterizer::forward(). A step along one view is backward_and_step(). For a step along several (--batch),
/// make_room_for_view() and backward_and_keep() follow each view; then step_views(). On a GPU, updates of SH
/// coefficients beyond degree 0 are deferred until a view sees the Gaussian (deferred_sh.h): call flush() before these
/// coefficients or their moments are read, and before any tensor is replaced.
class GaussianOptimizer {
 public:
  /// `rasterizer` must outlive this.
  explicit GaussianOptimizer(Rasterizer& rasterizer);

  /// `settings` for rendering or projecting the next view so that deferred updates of its colours are applied.
  RenderSettings begin_view(GaussianTensors& gaussians, AdamState& state, RenderSettings settings);

  /// Gradients of the view that was just rendered and of the regularisation, and one step along them. `stages` (may be
  /// null) records the optimizer stage, which on a GPU includes the projection's backward pass. Asynchronous on a GPU.
  ViewStatistics backward_and_step(const AdamRates& rates, const RenderedViewGrad& view_grad,
                                   GaussianTensors& gaussians, AdamState& state, StageRecorder* stages,
                                   const RegularizationWeights& regularization = {});

  /// Allocates what backward_and_keep() needs for the view that was just rendered.
  void make_room_for_view(const GaussianTensors& gaussians);
  /// The backward pass of that view up to its splats, which are kept.
  ViewStatistics backward_and_keep(const CameraView& view, const RenderSettings& settings,
                                   const RenderedViewGrad& view_grad, const GaussianTensors& gaussians,
                                   const RegularizationWeights& regularization = {});

  /// Of several ranks, each projects its Gaussians for every view of the step, another may render the view, and each
  /// keeps the sums of its splats: project_views() instead of Rasterizer::forward(), keep_splats() instead of
  /// backward_and_keep(). `n_splats`: of the view, on all ranks. keep_splats() allocates; project_views() throws as
  /// forward() does.
  std::vector<ViewSplats> project_views(GaussianTensors& gaussians, AdamState& state,
                                        const std::vector<CameraView>& views,
                                        const std::vector<RenderSettings>& settings);
  ViewStatistics keep_splats(const ViewSplats& own, const torch::Tensor& splat_grads, const CameraView& view,
                             const RenderSettings& settings, const GaussianTensors& gaussians, std::int64_t n_splats,
                             const RegularizationWeights& regularization = {});

  int n_kept_views() const { return batch_.n_views(); }
  /// Gradients of the mean over the n kept views, and one step along them, with sqrt(n) times `rates` and the moments'
  /// decays by adam_rule(). The result does not depend on where views were rendered. Allocates nothing.
  void step_views(const AdamRates& rates, GaussianTensors& gaussians, AdamState& state, StageRecorder* stages);
  /// Forgets the kept views.
  void drop_views() { batch_.clear(); }
  /// Memory for kept views, bytes.
  std::int64_t kept_bytes() const { return batch_.bytes(); }

  /// Applies all deferred updates. Asynchronous on a GPU.
  void flush(GaussianTensors& gaussians, AdamState& state);

 private:
  void make_room(const GaussianTensors& gaussians, std::int64_t n_splats);

  Rasterizer& rasterizer_;
  GaussianTensors grads_;  // on the CPU
  ViewBatch batch_;
  SplatOwner owner_;
  std::shared_ptr<cuda::DeferredSh> deferred_sh_;  // if this build has CUDA
};

}  // namespace b3dgs
