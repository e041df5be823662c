// One tensor per parameter group. Parameters, gradients and Adam's moments all have this structure.
#pragma once

#include <torch/types.h>

#include <array>
#include <cstdint>
#include <memory>
#include <vector>

#include "core/check.h"
#include "raster/args.h"
#include "raster/constants.h"
#include "raster/rasterizer_backend.h"

namespace b3dgs {

/// The groups, in the order that files and loops use. K = (SH degree + 1)^2.
struct GaussianTensors {
  torch::Tensor means;            // [N, 3] world space
  torch::Tensor log_scales;       // [N, 3]
  torch::Tensor quats;            // [N, 4] w x y z
  torch::Tensor logit_opacities;  // [N]
  torch::Tensor sh0;              // [N, 1, 3]
  torch::Tensor shN;              // [N, K-1, 3]

  // [N] world units, standard deviation of the 3D smoothing filter (raster/math/antialiasing.h). Derived from the means
  // and the training views, and not a parameter; undefined: no filter.
  torch::Tensor filters{};

  std::int64_t size() const { return means.defined() ? means.size(0) : 0; }

  static constexpr std::array<const char*, 6> kNames{"means", "log_scales", "quats", "logit_opacities", "sh0", "shN"};
  std::array<torch::Tensor*, 6> all() { return {&means, &log_scales, &quats, &logit_opacities, &sh0, &shN}; }
  std::array<const torch::Tensor*, 6> all() const {
    return {&means, &log_scales, &quats, &logit_opacities, &sh0, &shN};
  }
};

/// SH degree that shN is allocated for. @throws LogicError if its number of coefficients belongs to no degree
inline int sh_degree_of(const GaussianTensors& gaussians) {
  const std::int64_t k = gaussians.shN.size(1) + 1;
  for (int degree = 0; degree <= kShDegreeMax; ++degree) {
    if ((degree + 1) * (degree + 1) == k) return degree;
  }
  throw LogicError(detail::concat("shN has ", k - 1, " coefficients, expected 0, 3, 8 or 15"));
}

// The rasterizer for LibTorch, on CPU or GPU: the public interface of src/raster. Forward and backward are explicit
// calls rather than autograd functions: the graph of a training step is fixed, so there is no reason to record it.

/// A rendered view: float tensors on the rasterizer's device, overwritten by its next forward().
struct RenderedView {
  torch::Tensor color;  // [H, W, 3] RGB, not clamped
  torch::Tensor depth;  // [H, W] sum of weight times Splat::depth, or over it (inverse_depth)
  torch::Tensor alpha;  // [H, W] 1 - final transmittance
};

/// Gradients of the loss with respect to the rendered view. An undefined tensor means zero.
struct RenderedViewGrad {
  torch::Tensor color, depth, alpha;  // shapes as in RenderedView
};

/// What densification needs to know about the last view.
struct ViewStatistics {
  torch::Tensor means2d_grad;  // [N, 2] gradient of the loss with respect to the projected centre, 1/px
  torch::Tensor radii;         // [N] int32, 3 standard deviations in px, rounded up; 0 if not seen
  // [6] double, gradient of the loss with respect to a small motion of the camera (raster/math/gaussian_grad.h):
  // rotation (1/rad), translation (1/world unit). Valid until the next forward(). Undefined unless the settings had
  // camera_gradient.
  torch::Tensor camera_grad;
};

/// What a later backward projection needs of a view (SplatRecordArrays). Tensors may be larger.
struct SplatRecordTensors {
  torch::Tensor records;             // [M, 12] 32 bits each: SplatRecord
  torch::Tensor record_of_gaussian;  // [N] int32
};

/// Splats of one view, as projection leaves them for the other passes (SplatRows). Rows may come from several
/// projections with the same view and settings; each must be aligned as torch aligns new tensors.
struct ViewSplats {
  torch::Tensor splats;   // [M, 12] 32 bits each: Splat, with integers in columns 7 (`gaussian`) and 11 (`clamped`)
  torch::Tensor extents;  // [M, 2] half size of the box around alpha >= 1/255, px
  torch::Tensor radii;    // [M] int32, 3 standard deviations in px, rounded up
  // How many of them forward_splats() draws twice, across the seam of a panorama; set by projection alone.
  std::int64_t n_second = 0;
  std::int64_t size() const { return splats.defined() ? splats.size(0) : 0; }
};

/// What Rasterizer::score() adds to (ScoreArrays).
struct GaussianScores {
  torch::Tensor error_sum, max_weight, n_views;  // [N] each
  torch::Tensor weight_sum;                      // [N]; undefined: not wanted
};

struct ViewSize {
  std::int64_t n_splats = 0;  // Gaussians seen in the view
  std::int64_t n_pairs = 0;   // (tile, splat) pairs
};

/// Load of the blend in the last view (CountLoadArgs), on the host.
struct ViewLoad {
  torch::Tensor tile_lists;    // [n_tiles] int64, length of each tile's list
  torch::Tensor processed;     // [H, W] int32, list entries evaluated per pixel
  torch::Tensor contributing;  // [H, W] int32, list entries blended per pixel
};

/// @throws LogicError naming a tensor that does not fit, or if there was no such forward()
class Rasterizer {
 public:
  /// @throws InputError if this build does not support the device
  explicit Rasterizer(torch::Device device);

  /// Renders one view and, with settings.keep_for_backward, keeps what backward() needs. Parameters must be contiguous
  /// float tensors on the rasterizer's device.
  /// @throws InvalidGaussianError naming the first invalid Gaussian, as do the other projections
  RenderedView forward(const GaussianTensors& gaussians, const CameraView& view, const RenderSettings& settings);

  /// Gradients of the last forward(); `gaussians` must be unchanged. `grads` is overwritten; tensors that are undefined
  /// or of another shape are allocated.
  ViewStatistics backward(const GaussianTensors& gaussians, const RenderedViewGrad& grad, GaussianTensors& grads);

  /// The blending half of backward(), on a GPU. `rest` receives the arguments of the backward projection, for a kernel
  /// that uses each Gaussian's gradient without storing it. Its only gradient array is means2d of the returned
  /// statistics, which that kernel must write.
  ViewStatistics backward_blend(const GaussianTensors& gaussians, const RenderedViewGrad& grad,
                                cuda::ProjectBackwardCudaArgs& rest);

  /// backward() up to the splats, whose sums are written to `out`, so that the backward projection can follow after
  /// other views. `out` must have room for view_size().n_splats records.
  ViewStatistics backward_to_splats(const GaussianTensors& gaussians, const RenderedViewGrad& grad,
                                    const SplatRecordTensors& out);

  /// The first pass of forward() alone: the splats of the Gaussians that the view sees, in the order of the Gaussians,
  /// in new tensors. Waits once for a GPU, for their number. The view of the last forward() is lost.
  ViewSplats project(const GaussianTensors& gaussians, const CameraView& view, const RenderSettings& settings);

  /// project() for each of several views. Waits once for a GPU, for all of them, unless a view sees more of the
  /// Gaussians than those before; tensors may be parts of larger ones.
  std::vector<ViewSplats> project_views(const GaussianTensors& gaussians, const std::vector<CameraView>& views,
                                        const std::vector<RenderSettings>& settings);

  /// The other passes of forward(): the same image if `splats` is from project() with this view and these settings, or
  /// from several of them, put into one order: that of the rows decides between equal depths. Splat::gaussian is
  /// ignored. Then backward_splats(), score_splats(), reblend(), view_size() and count_load() may follow.
  /// @throws LogicError for settings.camera_gradient
  RenderedView forward_splats(const ViewSplats& splats, const CameraView& view, const RenderSettings& settings);

  /// The backward pass of the last forward_splats() up to the splats: a new tensor [M, 12] with a SplatGradSum for each
  /// row.
  torch::Tensor backward_splats(const RenderedViewGrad& grad);

  /// score() of the last forward_splats(): a new tensor [M, 6] int32 with a ScoreSums for each row.
  torch::Tensor score_splats(const torch::Tensor& error);

  /// Blends the view of the last forward() again with another kernel of its family, into the same tensors. Asynchronous
  /// on a GPU.
  RenderedView reblend(ForwardKernel kernel);
  /// The same for the backward blend, on a GPU only. Returns the splats' sums, [M, 10] (SplatGrad), which the next
  /// backward pass overwrites.
  torch::Tensor reblend_backward(const RenderedViewGrad& grad);
  /// Blends the view of the last forward() again and measures how well a kernel of the paper fills the GPU.
  /// @throws LogicError on the CPU, or for a kernel of ours
  KernelOccupancy measure_occupancy(ForwardKernel kernel);

  /// Size of the view of the last forward().
  ViewSize view_size() const;

  /// GPU memory of the buffers that are kept from view to view, bytes; 0 on the CPU.
  std::int64_t memory_bytes() const;
  /// Frees these buffers and the images. The next call must be forward().
  void release_memory();

  /// Work of the last forward() or forward_splats(): for each pixel row, the list entries up to the last one that each
  /// pixel blends, summed over its pixels. A new tensor [H] int64 on the device; asynchronous on a GPU. Cheaper than
  /// count_load(), and without the entries behind the last one.
  torch::Tensor row_entries() const;

  /// Counts the load of the last forward().
  ViewLoad count_load() const;

  /// Adds to `scores` what the pixels of the last forward() say about its Gaussians: sums of their weights, and of
  /// weights times `error` [H, W], whose values count within [0, 1]. Exactly the same for any forward kernel and number
  /// of threads. Overwrites the sums of the last backward(). Asynchronous on a GPU.
  void score(const torch::Tensor& error, const GaussianScores& scores);

 private:
  RasterizerBackend& backend() const;
  ImageArrays begin_view(const CameraView& view, const torch::TensorOptions& options);
  ImageGradArrays image_grad(const RenderedViewGrad& grad) const;
  const float* error_image(const torch::Tensor& error) const;
  ViewStatistics& begin_statistics(std::int64_t n);
  const ViewStatistics& finish_statistics();

  torch::Device device_;
  mutable std::unique_ptr<RasterizerBackend> backend_;  // made when it is first used
  RenderedView rendered_;
  torch::Tensor color_storage_, depth_storage_, alpha_storage_, means2d_storage_;
  ViewStatistics statistics_;
  double seen_share_ = 0;  // largest share of the Gaussians that a view of project_views() has seen
};

// For a rank whose splats another rank renders: what Rasterizer would have done with the sums that come back. `splats`
// is from Rasterizer::project() with this view and these settings, `splat_grads` from backward_splats() and `scores`
// from score_splats(), with rows in the same order. Asynchronous on a GPU. @throws LogicError naming a tensor that does
// not fit

class SplatOwner {
 public:
  /// Writes to `out` what backward_to_splats() would write, except that record m is that of row m; `out` must have room
  /// for all splats. Returns the statistics, whose tensors the next call overwrites.
  ViewStatistics keep(const ViewSplats& splats, const torch::Tensor& splat_grads, std::int64_t n_gaussians,
                      const SplatRecordTensors& out);

 private:
  torch::Tensor means2d_storage_, radii_storage_;
  ViewStatistics statistics_;
};

/// Adds to `out` what score() would have added.
void add_splat_scores(const ViewSplats& splats, const torch::Tensor& scores, const GaussianScores& out);

/// What each splat adds to the gradient with respect to the camera's pose (ViewStatistics::camera_grad), a new tensor
/// [M, 6].
torch::Tensor camera_parts(const GaussianTensors& gaussians, const ViewSplats& splats, const torch::Tensor& splat_grads,
                           const CameraView& view, const RenderSettings& settings);

/// Their sum over all splats of a view, a new tensor [6] double: what backward() would have computed if rows are in the
/// order of project(). Equal only up to rounding for a panorama on the CPU: there backward() adds a Gaussian's two
/// splats separately, but the owner gets only their sum.
torch::Tensor sum_camera_parts(const torch::Tensor& parts);

}  // namespace b3dgs
