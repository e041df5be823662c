// The whole rasterizer on the GPU, without torch. Counterpart of cpu/rasterize_cpu.h.
#pragma once

#include <memory>
#include <vector>

#include "raster/cuda/passes.h"

namespace b3dgs::cuda {

class Rasterizer {
 public:
  Rasterizer();
  ~Rasterizer();
  Rasterizer(Rasterizer&&) noexcept;
  Rasterizer& operator=(Rasterizer&&) noexcept;

  /// Renders one view into `out` (device memory) and, with settings.keep_for_backward, keeps what backward() needs.
  /// Waits for the device once, for the numbers of splats and pairs. `colors` computes the colours; null: the
  /// projection does.
  /// @throws InvalidGaussianError naming the first invalid Gaussian; NumericError for too many pairs; CudaError
  void forward(const GaussianArrays& gaussians, const PinholeView& view, const RenderSettings& settings,
               const ImageArrays& out, const LaunchContext& context, ColorPass* colors = nullptr);

  /// Gradients of the last forward(). `gaussians` and the images that forward() wrote must be unchanged. Does not wait
  /// for the device, and neither do the functions below.
  void backward(const GaussianArrays& gaussians, const ImageGradArrays& grad, const GaussianGradArrays& out,
                const LaunchContext& context);

  /// The first half of backward(): the backward blend and, if wanted, the gradient with respect to the camera. Returns
  /// the arguments of project_backward() without the gradient arrays; valid until the next forward().
  ProjectBackwardCudaArgs backward_blend(const GaussianArrays& gaussians, const ImageGradArrays& grad,
                                         const LaunchContext& context);

  /// backward() up to the splats: keeps their sums, in device memory, for a later backward projection.
  void backward_to_splats(const GaussianArrays& gaussians, const ImageGradArrays& grad, const SplatRecordArrays& out,
                          const LaunchContext& context);

  /// The first pass of forward() alone: writes the splats of the Gaussians that the view sees, in the order of the
  /// Gaussians, to the device memory that `allocate` returns. There is no last forward() after it. Waits for the device
  /// once, for the number of splats. @throws InvalidGaussianError naming the first invalid Gaussian; CudaError
  void project(const GaussianArrays& gaussians, const PinholeView& view, const RenderSettings& settings,
               const SplatAllocator& allocate, const LaunchContext& context, ColorPass* colors = nullptr);

  /// project() for view number `place` of several, without waiting: writes at most `capacity` splats to `out`. Then the
  /// next one, or wait_for_projections(). @throws CudaError
  void queue_projection(std::size_t place, const GaussianArrays& gaussians, const PinholeView& view,
                        const RenderSettings& settings, const SplatRowArrays& out, std::int64_t capacity,
                        const LaunchContext& context, ColorPass* colors = nullptr);
  /// Numbers of splats of the views that were queued, in their order, all of them also if there was no room for them.
  /// Waits for the device once. @throws InvalidGaussianError naming the first invalid Gaussian of the first view that
  /// has one
  std::vector<std::int64_t> wait_for_projections();

  /// The other passes of forward(), with the same view, culling and tiles as in project(). Splat::gaussian is ignored.
  /// A forward() for the functions below, except for those that need Gaussians: backward(), backward_blend(),
  /// backward_to_splats(), camera_gradient() and score(). Waits for the device once.
  /// @throws LogicError if settings.camera_gradient; NumericError for too many pairs; CudaError
  void forward_splats(const SplatRows& rows, const PinholeView& view, const RenderSettings& settings,
                      const ImageArrays& out, const LaunchContext& context);

  /// The backward blend of the last forward_splats(): sums of each row, [M] out, device memory.
  void backward_splats(const ImageGradArrays& grad, SplatGradSum* out, const LaunchContext& context);

  /// [M] of the last forward_splats(), device memory: place of each row in splats(), for rows with radii() above 0.
  const std::int32_t* rank_of_row() const;

  /// score() of the last forward_splats(): sums of each row, [M] out, device memory; padding is 0.
  void score_splats(const float* error, ScoreSums* out, const LaunchContext& context);

  /// Runs a blending pass of the last forward() again with another kernel: into the same images, or into splat_grads().
  void reblend(ForwardKernel kernel, const LaunchContext& context);
  void reblend_backward(BackwardKernel kernel, const ImageGradArrays& grad, const LaunchContext& context);

  /// Counts the load of the last forward() into two device arrays, [H, W] each (CountLoadArgs).
  void count_load(std::int32_t* processed, std::int32_t* contributing, const LaunchContext& context) const;

  /// [kCameraGradients] device memory: gradient with respect to the camera's pose (math/camera_grad.h), of the last
  /// backward_blend(), after a forward() with camera_gradient.
  const double* camera_gradient() const;

  /// Adds what the pixels of the last forward() say about its Gaussians, given an error [H, W] (ScoreArgs); device
  /// arrays. Overwrites splat_grads(), so that after a forward() with keep_for_backward it allocates nothing.
  void score(const float* error, const ScoreArrays& out, const LaunchContext& context);

  /// [M, 12] floats in device memory: the splats' sums of the last backward blend, of which the first 10 are
  /// a SplatGrad. In the order of splats().
  const float* splat_grads() const;

  /// Device arrays of the last forward():
  const std::int32_t* radii() const;     // [N]
  const std::int32_t* last_ids() const;  // [H, W]
  const Splat* splats() const;           // [M] in depth order, indexed by bins().splat_ids
  BinnedSplats bins() const;
  TileGrid grid() const;
  std::int64_t n_splats() const;

  /// GPU memory of all buffers, which are kept from view to view (view_memory.h forecasts it).
  std::int64_t memory_bytes() const;
  /// Frees all buffers. The next call must be forward().
  void release_memory();

  struct Impl;

 private:
  std::unique_ptr<Impl> impl_;
};

}  // namespace b3dgs::cuda
