// The rasterizer for LibTorch, on CPU or GPU: the public interface of src/raster. Forward and backward are explicit
// calls rather than autograd functions, because the graph of a training step is fixed and does not have to be recorded.
#pragma once

#include <torch/types.h>

#include <array>
#include <cstdint>
#include <memory>
#include <vector>

#include "core/check.h"
#include "raster/args.h"
#include "raster/constants.h"
#include "raster/geometry.h"
#include "raster/rasterizer_backend.h"

namespace b3dgs {

/// The parameters of all Gaussians, one tensor per group, in the order that files and loops use. Gradients and Adam's
/// moments have the same structure. K = (SH degree + 1)^2.
struct GaussianTensors {
  torch::Tensor means;            // [N, 3] world space
  torch::Tensor log_scales;       // [N, 3]
  torch::Tensor quats;            // [N, 4] w x y z
  torch::Tensor logit_opacities;  // [N]
  torch::Tensor sh0;              // [N, 1, 3]
  torch::Tensor shN;              // [N, K-1, 3]

  // [N] Standard deviation of the 3D smoothing filter in world units (raster/math/antialiasing.h). It is derived from
  // the means and the training views and is not a parameter. Undefined means no filter.
  torch::Tensor filters{};

  std::int64_t size() const { return means.defined() ? means.size(0) : 0; }

  static constexpr std::array<const char*, 6> kNames{"means", "log_scales", "quats", "logit_opacities", "sh0", "shN"};
  std::array<torch::Tensor*, 6> all() { return {&means, &log_scales, &quats, &logit_opacities, &sh0, &shN}; }
  std::array<const torch::Tensor*, 6> all() const {
    return {&means, &log_scales, &quats, &logit_opacities, &sh0, &shN};
  }
};

/// Returns the SH degree of shN. @throws LogicError if its number of coefficients belongs to no degree
inline int sh_degree_of(const GaussianTensors& gaussians) {
  const std::int64_t k = gaussians.shN.size(1) + 1;
  for (int degree = 0; degree <= kShDegreeMax; ++degree) {
    if ((degree + 1) * (degree + 1) == k) return degree;
  }
  throw LogicError(detail::concat("shN has ", k - 1, " coefficients, expected 0, 3, 8 or 15"));
}

/// A rendered view: float tensors on the rasterizer's device, overwritten by its next forward().
struct RenderedView {
  torch::Tensor color;  // [H, W, 3] RGB, not clamped
  torch::Tensor depth;  // [H, W] sum of weight times Splat::depth, or of weight over it (inverse_depth)
  torch::Tensor alpha;  // [H, W] 1 - final transmittance
};

/// Gradients of the loss with respect to the rendered view. An undefined tensor means zero.
struct RenderedViewGrad {
  torch::Tensor color, depth, alpha;  // shapes as in RenderedView
};

/// Statistics of the last view for densification.
struct ViewStatistics {
  torch::Tensor means2d_grad;  // [N, 2] gradient of the loss with respect to the projected centre, 1/px
  torch::Tensor radii;         // [N] int32, 3 standard deviations in px, rounded up; 0 if not visible
  // [6] double, gradient of the loss with respect to a small motion of the camera (raster/math/gaussian_grad.h):
  // rotation (1/rad), translation (1/world unit). Valid until the next forward(). Undefined unless the settings had
  // camera_gradient.
  torch::Tensor camera_grad;
};

/// Data of a view for a later backward projection (SplatRecordArrays). Tensors may be larger.
struct SplatRecordTensors {
  torch::Tensor records;             // [M, 12], 32 bits each: SplatRecord
  torch::Tensor record_of_gaussian;  // [N] int32
};

/// Splats of one view as projection writes them for the other passes (SplatRows). Rows may come from several
/// projections with the same view and settings. Each tensor must be aligned like a new torch tensor.
struct ViewSplats {
  torch::Tensor splats;   // [M, 12], 32 bits each: Splat, with integers in columns 7 (`gaussian`) and 11 (`clamped`)
  torch::Tensor extents;  // [M, 2] half size of the box around alpha >= 1/255, px
  torch::Tensor radii;    // [M] int32, 3 standard deviations in px, rounded up
  // Number of splats that forward_splats() draws twice, across the seam of a panorama. Only projection sets it.
  std::int64_t n_second = 0;
  std::int64_t size() const { return splats.defined() ? splats.size(0) : 0; }
};

/// The scores that Rasterizer::score() adds to (ScoreArrays).
struct GaussianScores {
  torch::Tensor error_sum, max_weight, n_views;  // [N] each
  torch::Tensor weight_sum;                      // [N]; undefined: not computed
};

/// Depth and normals of the surface that a view shows, in new tensors (GeometryArrays). Pixels without a surface are 0.
struct SurfaceView {
  torch::Tensor depth;       // [H, W] world units, measured like Splat::depth
  torch::Tensor normal;      // [H, W, 3] unit vector of the camera frame, towards the camera
  torch::Tensor confidence;  // [H, W] at most 1
};

struct ViewSize {
  std::int64_t n_splats = 0;  // visible Gaussians
  std::int64_t n_pairs = 0;   // (tile, splat) pairs
};

/// Load of the blend in the last view (CountLoadArgs), on the host.
struct ViewLoad {
  torch::Tensor tile_lists;    // [n_tiles] int64, length of each tile's list
  torch::Tensor processed;     // [H, W] int32, list entries evaluated per pixel
  torch::Tensor contributing;  // [H, W] int32, list entries blended per pixel
};

/// Renders views. @throws LogicError naming a tensor that does not fit, or if there was no such forward()
class Rasterizer {
 public:
  /// @throws InputError if this build does not support the device
  explicit Rasterizer(torch::Device device);

  /// Renders one view. With settings.keep_for_backward, it also keeps the data for backward(). Parameters must be
  /// contiguous float tensors on the rasterizer's device.
  /// @throws InvalidGaussianError naming the first invalid Gaussian, as do the other projections
  RenderedView forward(const GaussianTensors& gaussians, const CameraView& view, const RenderSettings& settings);

  /// Computes the gradients of the last forward(). `gaussians` must be unchanged. `grads` is overwritten. Tensors that
  /// are undefined or have another shape are allocated.
  ViewStatistics backward(const GaussianTensors& gaussians, const RenderedViewGrad& grad, GaussianTensors& grads);

  /// Runs the blending half of backward(), on a GPU. `rest` receives the arguments of the backward projection, for a
  /// kernel that uses the gradient of each Gaussian without storing it. Its only gradient array is means2d of the
  /// returned statistics, which that kernel must write.
  ViewStatistics backward_blend(const GaussianTensors& gaussians, const RenderedViewGrad& grad,
                                cuda::ProjectBackwardCudaArgs& rest);

  /// Runs backward() up to the splats and writes their sums to `out`, so that the backward projection can follow after
  /// other views. `out` must have capacity for view_size().n_splats records.
  ViewStatistics backward_to_splats(const GaussianTensors& gaussians, const RenderedViewGrad& grad,
                                    const SplatRecordTensors& out);

  /// Runs only the first pass of forward(). Returns the splats of the visible Gaussians, in the order of the Gaussians,
  /// in new tensors. Waits once for a GPU, for their number. The view of the last forward() is lost.
  ViewSplats project(const GaussianTensors& gaussians, const CameraView& view, const RenderSettings& settings);

  /// Runs project() for several views. The first call waits for a GPU at each view. Later calls wait once for all
  /// views. If a view sees over 10 % more of the Gaussians than any view before, it is projected again, which waits
  /// once more. Tensors may be parts of larger ones.
  std::vector<ViewSplats> project_views(const GaussianTensors& gaussians, const std::vector<CameraView>& views,
                                        const std::vector<RenderSettings>& settings);

  /// Runs the other passes of forward(). The image is the same if `splats` is from project() with this view and these
  /// settings, or from several of them, merged in one order. The order of the rows decides between equal depths.
  /// Splat::gaussian is ignored. Then backward_splats(), score_splats(), reblend(), view_size() and count_load() may
  /// follow.
  /// @throws LogicError for settings.camera_gradient
  RenderedView forward_splats(const ViewSplats& splats, const CameraView& view, const RenderSettings& settings);

  /// Runs the backward pass of the last forward_splats() up to the splats. Returns a new tensor [M, 12] with a
  /// SplatGradSum for each row.
  torch::Tensor backward_splats(const RenderedViewGrad& grad);

  /// Runs score() for the last forward_splats(). Returns a new tensor [M, 6] int32 with a ScoreSums for each row.
  torch::Tensor score_splats(const torch::Tensor& error);

  /// Blends the view of the last forward() again with another kernel of its family, into the same tensors. Asynchronous
  /// on a GPU.
  RenderedView reblend(ForwardKernel kernel);
  /// The same for the backward blend, on a GPU only. Returns the splats' sums, [M, 10] (SplatGrad), which the next
  /// backward pass overwrites.
  torch::Tensor reblend_backward(const RenderedViewGrad& grad);
  /// Blends the view of the last forward() again and measures how well a kernel of the paper fills the GPU.
  /// @throws LogicError on the CPU, or for one of our own kernels
  KernelOccupancy measure_occupancy(ForwardKernel kernel);

  /// Returns the camera centre of the last forward() in world space.
  Vec3f camera_center() const { return camera_center_; }
  /// Returns the size of the view of the last forward().
  ViewSize view_size() const;

  /// Returns the GPU memory of the buffers that are kept from view to view in bytes, 0 on the CPU.
  std::int64_t memory_bytes() const;
  /// Frees these buffers and the images. The next call must be forward().
  void release_memory();

  /// Returns the work of the last forward() or forward_splats(): for each pixel row, the list entries up to the last
  /// one that each pixel blends, summed over its pixels. A new tensor [H] int64 on the device, asynchronous on a GPU.
  /// Cheaper than count_load(), but without the entries behind the last one.
  torch::Tensor row_entries() const;

  /// Counts the load of the last forward().
  ViewLoad count_load() const;

  /// Computes the geometry of the last forward(), with any settings. `gaussians` must be unchanged. Exactly the same
  /// for any forward kernel and number of threads. backward() may still follow. Asynchronous on a GPU.
  SurfaceView geometry(const GaussianTensors& gaussians, DepthKind kind = DepthKind::kSurface);

  /// Adds the scores of the last forward() to `scores`: sums of the Gaussians' weights, and of weights times `error`
  /// [H, W], which is clamped to [0, 1]. Exactly the same for any forward kernel and number of threads. Overwrites the
  /// sums of the last backward(). Asynchronous on a GPU.
  void score(const torch::Tensor& error, const GaussianScores& scores);

 private:
  RasterizerBackend& backend() const;
  ImageArrays begin_view(const CameraView& view, const torch::TensorOptions& options);
  ImageGradArrays image_grad(const RenderedViewGrad& grad) const;
  const float* error_image(const torch::Tensor& error) const;
  ViewStatistics& begin_statistics(std::int64_t n);
  const ViewStatistics& finish_statistics();

  torch::Device device_;
  mutable std::unique_ptr<RasterizerBackend> backend_;  // made on first use
  RenderedView rendered_;
  torch::Tensor color_storage_, depth_storage_, alpha_storage_, means2d_storage_;
  ViewStatistics statistics_;
  Vec3f camera_center_{0, 0, 0};
  double seen_share_ = 0;  // largest share of the Gaussians that a view of project_views() has seen
};

// For a rank whose splats another rank renders: does what Rasterizer would have done with the sums that come back.
// `splats` is from Rasterizer::project() with this view and these settings, `splat_grads` from backward_splats() and
// `scores` from score_splats(), with rows in the same order. Asynchronous on a GPU. @throws LogicError naming a tensor
// that does not fit

class SplatOwner {
 public:
  /// Writes the output of backward_to_splats() to `out`, except that record m belongs to row m. `out` must have
  /// capacity for all splats. Returns the statistics, whose tensors the next call overwrites.
  ViewStatistics keep(const ViewSplats& splats, const torch::Tensor& splat_grads, std::int64_t n_gaussians,
                      const SplatRecordTensors& out);

 private:
  torch::Tensor means2d_storage_, radii_storage_;
  ViewStatistics statistics_;
};

/// Adds to `out` what score() would have added.
void add_splat_scores(const ViewSplats& splats, const torch::Tensor& scores, const GaussianScores& out);

/// Returns the contribution of each splat to the gradient of the camera's pose (ViewStatistics::camera_grad), a new
/// tensor [M, 6].
torch::Tensor camera_parts(const GaussianTensors& gaussians, const ViewSplats& splats, const torch::Tensor& splat_grads,
                           const CameraView& view, const RenderSettings& settings);

/// Returns their sum over all splats of a view, a new tensor [6] double. It equals the result of backward() if rows are
/// in the order of project(). For a panorama on the CPU it is equal only up to rounding, because there backward() adds
/// a Gaussian's two splats separately, but the owner gets only their sum.
torch::Tensor sum_camera_parts(const torch::Tensor& parts);

}  // namespace b3dgs
