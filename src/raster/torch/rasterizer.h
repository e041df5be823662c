// The rasterizer for LibTorch: the only header of this folder that the trainer and the commands need.
//
// Forward and backward are explicit calls instead of autograd functions: a training step has one fixed graph, so
// nothing is gained by recording it, and every buffer can stay where it is from step to step.
#pragma once

#include <memory>

#include "raster/args.h"
#include "raster/torch/gaussian_tensors.h"

namespace b3dgs {

namespace cuda {
struct ProjectBackwardCudaArgs;
}

/// A rendered view; float tensors on the device of the parameters, overwritten by the next forward of the same
/// Rasterizer.
struct RenderedView {
  torch::Tensor color;  // [H, W, 3] RGB, not clamped
  torch::Tensor depth;  // [H, W] sum of weight times view-space z, world units
  torch::Tensor alpha;  // [H, W]
};

/// Gradients by the rendered view; an undefined tensor stands for zeros.
struct RenderedViewGrad {
  torch::Tensor color, depth, alpha;
};

/// What densification wants to know about the last view.
struct ViewStatistics {
  torch::Tensor means2d_grad;  // [N, 2] gradient by the projected centre, 1/px
  torch::Tensor radii;         // [N] int32, 3 standard deviations in px, rounded up; 0: not seen in this view
};

struct ViewSize {
  std::int64_t n_splats = 0, n_pairs = 0;
};

/// What the last view asked of the blend (CountLoadArgs).
struct ViewLoad {
  torch::Tensor tile_lists;    // [n_tiles] int64, length of each tile's list
  torch::Tensor processed;     // [H, W] int32
  torch::Tensor contributing;  // [H, W] int32
};

class Rasterizer {
 public:
  explicit Rasterizer(torch::Device device);
  ~Rasterizer();
  Rasterizer(Rasterizer&&) noexcept;
  Rasterizer& operator=(Rasterizer&&) noexcept;

  /// Renders one view and keeps what backward() needs. Parameters are contiguous float tensors on the device.
  /// @throws InvalidGaussianError naming the Gaussian if a parameter it needs is not finite.
  RenderedView forward(const GaussianTensors& gaussians, const PinholeView& view, const RenderSettings& settings);

  /// Gradients of the last forward(); `gaussians` must be unchanged since. `grads` is allocated if undefined or of
  /// another size, and overwritten.
  ViewStatistics backward(const GaussianTensors& gaussians, const RenderedViewGrad& grad, GaussianTensors& grads);

  /// The blend's half of backward(), on a GPU only. `rest` says what is left to do for each Gaussian: for a kernel that
  /// goes on with the gradient instead of storing it. It has the array of the statistics' means2d_grad, which that
  /// kernel has to fill.
  ViewStatistics backward_blend(const GaussianTensors& gaussians, const RenderedViewGrad& grad,
                                cuda::ProjectBackwardCudaArgs& rest);

  /// Blends the view of the last forward() again with another kernel, into the same tensors: all that two kernels can
  /// differ in, without the passes that they share. On a GPU it does not wait.
  RenderedView reblend(ForwardKernel kernel);

  /// Likewise the backward blend, on a GPU only. Gradients by the splats' ellipses, colours and depths, [M, 10],
  /// overwritten by the next backward pass.
  torch::Tensor reblend_backward(BackwardKernel kernel, const RenderedViewGrad& grad);

  /// Splats and (tile, splat) pairs of the last forward().
  ViewSize view_size() const;

  /// On a GPU: of the buffers that are kept from view to view.
  std::int64_t memory_bytes() const;
  /// Gives them back. A forward() has to come next.
  void release_memory();

  /// Counts for the view of the last forward(), on the host.
  ViewLoad count_load() const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace b3dgs
