// The views of a step of several views (--batch), between their backward blends and the step.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "raster/torch/rasterizer.h"
#include "train/optimizer/batch_grad.h"

namespace b3dgs {

/// Keeps the splats of each view. Reuses its memory from step to step.
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

}  // namespace b3dgs
