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

/// Takes Adam steps along the gradients of one or several views. Each view begins with begin_view(), and is rendered
/// with Rasterizer::forward(). A step along one view is backward_and_step(). In a step along several views (--batch),
/// each view is followed by make_room_for_view() and backward_and_keep(), and the last one by step_views(). On a GPU,
/// updates of SH coefficients beyond degree 0 are deferred until the Gaussian becomes visible (deferred_sh.h). Call
/// flush() before these coefficients or their moments are read, and before any tensor is replaced.
class GaussianOptimizer {
 public:
  /// `rasterizer` must outlive this object. `sh_decay`: --sh_decay.
  explicit GaussianOptimizer(Rasterizer& rasterizer, double sh_decay = 0);

  /// Returns `settings` changed so that rendering or projecting the next view applies the deferred updates of its
  /// colours. If the state has no viewing directions but the decay needs them, adds them.
  RenderSettings begin_view(GaussianTensors& gaussians, AdamState& state, RenderSettings settings);

  /// Computes the gradients of the last rendered view and of the regularisation, and takes one step along them.
  /// `stages` (may be null) records the optimizer stage, which on a GPU includes the backward projection. Asynchronous
  /// on a GPU.
  ViewStatistics backward_and_step(const AdamRates& rates, const RenderedViewGrad& view_grad,
                                   GaussianTensors& gaussians, AdamState& state, StageRecorder* stages,
                                   const RegularizationWeights& regularization = {});

  /// Allocates the memory that backward_and_keep() needs for the last rendered view.
  void make_room_for_view(const GaussianTensors& gaussians);
  /// Runs the backward pass of the last rendered view up to its splats, and keeps their gradients.
  ViewStatistics backward_and_keep(const CameraView& view, const RenderSettings& settings,
                                   const RenderedViewGrad& view_grad, const GaussianTensors& gaussians,
                                   const RegularizationWeights& regularization = {});

  /// With several ranks, each rank projects its Gaussians for every view of the step, one rank renders the view, and
  /// each rank keeps the sums of its own splats. project_views() replaces Rasterizer::forward(), and keep_splats()
  /// replaces backward_and_keep(). `n_splats` is the number of splats of the view on all ranks. keep_splats() allocates
  /// memory. project_views() throws the same errors as forward().
  std::vector<ViewSplats> project_views(GaussianTensors& gaussians, AdamState& state,
                                        const std::vector<CameraView>& views,
                                        const std::vector<RenderSettings>& settings);
  ViewStatistics keep_splats(const ViewSplats& own, const torch::Tensor& splat_grads, const CameraView& view,
                             const RenderSettings& settings, const GaussianTensors& gaussians, std::int64_t n_splats,
                             const RegularizationWeights& regularization = {});

  int n_kept_views() const { return static_cast<int>(n_kept_); }
  /// Computes the gradients of the mean over the n kept views and takes one step along them, with `rates` times sqrt(n)
  /// and the decay of the moments in adam_rule(). The result does not depend on where the views were rendered. If
  /// memory is short, throws before anything has changed.
  void step_views(const AdamRates& rates, GaussianTensors& gaussians, AdamState& state, StageRecorder* stages);
  /// Discards the kept views.
  void drop_views() { n_kept_ = 0; }
  /// Returns the memory for kept views in bytes.
  std::int64_t kept_bytes() const;

  /// Applies all deferred updates. Asynchronous on a GPU.
  void flush(GaussianTensors& gaussians, AdamState& state);

 private:
  /// A view in a step of several, between its backward blend and the step. Its memory is reused from step to step.
  struct KeptView {
    SplatRecordTensors splats;
    torch::Tensor record_room, index_room;
    CameraView view{};
    RegularizationGrad regularization{};
  };
  /// Allocates memory for one more view of `n_splats` splats.
  void make_room(const GaussianTensors& gaussians, std::int64_t n_splats);
  /// Adds the view that make_room() was called for to the kept views.
  void keep(const CameraView& view, const RenderSettings& settings, const RegularizationGrad& regularization);

  /// Returns the arguments of the decay in a step along n views.
  ShDecayArgs sh_decay(const AdamState& state, int n_views) const;

  Rasterizer& rasterizer_;
  double sh_decay_ = 0;
  GaussianTensors grads_;  // on the CPU
  std::vector<KeptView> views_;
  std::size_t n_kept_ = 0;        // number of views_ in use
  RenderSettings kept_settings_;  // of all kept views
  SplatOwner owner_;
  std::shared_ptr<cuda::DeferredSh> deferred_sh_;  // null without CUDA
};

}  // namespace b3dgs
