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

  int n_kept_views() const { return static_cast<int>(n_kept_); }
  /// Gradients of the mean over the n kept views, and one step along them, with sqrt(n) times `rates` and the moments'
  /// decays by adam_rule(). The result does not depend on where views were rendered. If memory is short, throws before
  /// anything has changed.
  void step_views(const AdamRates& rates, GaussianTensors& gaussians, AdamState& state, StageRecorder* stages);
  /// Forgets the kept views.
  void drop_views() { n_kept_ = 0; }
  /// Memory for kept views, bytes.
  std::int64_t kept_bytes() const;

  /// Applies all deferred updates. Asynchronous on a GPU.
  void flush(GaussianTensors& gaussians, AdamState& state);

 private:
  /// A view of a step of several, between its backward blend and the step. Reuses its memory from step to step.
  struct KeptView {
    SplatRecordTensors splats;
    torch::Tensor record_room, index_room;
    CameraView view{};
    RegularizationGrad regularization{};
  };
  /// Room for one more view of `n_splats` splats.
  void make_room(const GaussianTensors& gaussians, std::int64_t n_splats);
  /// The view whose splats are to be written next, which make_room() was called for; from here on it is kept.
  void keep(const CameraView& view, const RenderSettings& settings, const RegularizationGrad& regularization);

  Rasterizer& rasterizer_;
  GaussianTensors grads_;  // on the CPU
  std::vector<KeptView> views_;
  std::size_t n_kept_ = 0;        // of views_
  RenderSettings kept_settings_;  // of all kept views
  SplatOwner owner_;
  std::shared_ptr<cuda::DeferredSh> deferred_sh_;  // if this build has CUDA
};

}  // namespace b3dgs
