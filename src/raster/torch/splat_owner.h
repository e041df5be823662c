// For a rank whose splats another rank renders: stores the sums that come back where Rasterizer::backward_to_splats()
// and Rasterizer::score() would have stored them.
#pragma once

#include "raster/torch/rasterizer.h"

namespace b3dgs {

class SplatOwner {
 public:
  /// Writes to `out` what backward_to_splats() would write, except that record m is that of row m; `out` must have room
  /// for all splats. Returns the statistics, whose tensors the next call overwrites. `splats` is from
  /// Rasterizer::project() of `n_gaussians` Gaussians, `splat_grads` [M, 12] from Rasterizer::backward_splats(), rows
  /// in the same order. Nothing waits for a GPU. @throws LogicError naming a tensor that does not fit
  ViewStatistics keep(const ViewSplats& splats, const torch::Tensor& splat_grads, std::int64_t n_gaussians,
                      const SplatRecordTensors& out);

 private:
  torch::Tensor means2d_storage_, radii_storage_;
  ViewStatistics statistics_;
};

/// Adds to `out` what Rasterizer::score() would have added. `splats` is from Rasterizer::project(), `scores` [M, 6]
/// int32 from Rasterizer::score_splats(), rows in the same order. @throws LogicError naming a tensor that does not fit
void add_splat_scores(const ViewSplats& splats, const torch::Tensor& scores, const GaussianScores& out);

/// What each splat adds to the gradient with respect to the camera's pose (ViewStatistics::camera_grad), a new tensor
/// [M, 6]. `splats` is from Rasterizer::project() of these Gaussians, view and settings, `splat_grads` [M, 12] from
/// Rasterizer::backward_splats(), rows in the same order. @throws LogicError naming a tensor that does not fit
torch::Tensor camera_parts(const GaussianTensors& gaussians, const ViewSplats& splats, const torch::Tensor& splat_grads,
                           const CameraView& view, const RenderSettings& settings);

/// Their sum over all splats of a view, a new tensor [6] double: exactly what Rasterizer::backward() would have
/// computed if rows are in the order of Rasterizer::project(). Of a panorama on the CPU up to rounding: there
/// backward() adds what each of a Gaussian's two splats adds, but only the sums of both together come back to the
/// owner. @throws LogicError naming a tensor that does not fit
torch::Tensor sum_camera_parts(const torch::Tensor& parts);

}  // namespace b3dgs
