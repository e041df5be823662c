// The whole rasterizer on the GPU, without torch. Mirrors cpu/rasterize_cpu.h.
#pragma once

#include <memory>

#include "raster/cuda/passes.h"

namespace b3dgs::cuda {

class Rasterizer {
 public:
  Rasterizer();
  ~Rasterizer();
  Rasterizer(Rasterizer&&) noexcept;
  Rasterizer& operator=(Rasterizer&&) noexcept;

  /// Renders one view into `out` (device memory) and, if settings.keep_for_backward, keeps what backward() needs. Waits
  /// once, for the numbers of splats and pairs.
  /// @throws NumericError naming the first Gaussian whose projection is not finite; CudaError
  void forward(const GaussianArrays& gaussians, const PinholeView& view, const RenderSettings& settings,
               const ImageArrays& out, const LaunchContext& context);

  /// Gradients of the last forward(). `gaussians` and the arrays it rendered into must be unchanged since. Does not
  /// wait.
  void backward(const GaussianArrays& gaussians, const ImageGradArrays& grad, const GaussianGradArrays& out,
                const LaunchContext& context);

  /// The first half of backward(), to the splats' sums. Returns what project_backward() still has to do, without the
  /// arrays for gradients; valid until the next forward(). Does not wait.
  ProjectBackwardCudaArgs backward_blend(const GaussianArrays& gaussians, const ImageGradArrays& grad,
                                         const LaunchContext& context);

  /// The blends of the last forward() alone, again with another kernel: into the same arrays, or into splat_grads().
  /// Neither waits.
  void reblend(ForwardKernel kernel, const LaunchContext& context);
  void reblend_backward(BackwardKernel kernel, const ImageGradArrays& grad, const LaunchContext& context);

  /// Of the last forward(), into device arrays [H, W] each (CountLoadArgs). Does not wait.
  void count_load(std::int32_t* processed, std::int32_t* contributing, const LaunchContext& context) const;

  /// [M] what the last backward blend summed per splat, 12 floats each of which 10 count (SplatGrad); device memory.
  const float* splat_grads() const;

  /// Device arrays of the last forward().
  const std::int32_t* radii() const;     // [N]
  const std::int32_t* last_ids() const;  // [H, W]
  const Splat* splats() const;           // [M] nearest first: what bins().splat_ids index
  BinnedSplats bins() const;
  TileGrid grid() const;
  std::int64_t n_splats() const;

  /// Of all buffers that are kept from view to view (view_memory.h says what a view needs).
  std::int64_t memory_bytes() const;
  /// Gives them back; a forward() has to come next. Does not wait.
  void release_memory();

  struct Impl;

 private:
  std::unique_ptr<Impl> impl_;
};

}  // namespace b3dgs::cuda
