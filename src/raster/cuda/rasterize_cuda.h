// The whole rasterizer on the GPU, without torch. Mirrors cpu/rasterize_cpu.h.
#pragma once

#include <memory>

#include "raster/args.h"
#include "raster/cuda/device_buffer.h"

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

  /// Device arrays of the last forward().
  const std::int32_t* radii() const;     // [N]
  const std::int32_t* last_ids() const;  // [H, W]
  const Splat* splats() const;           // [M] nearest first: what bins().splat_ids index
  BinnedSplats bins() const;
  TileGrid grid() const;
  std::int64_t n_splats() const;

  struct Impl;

 private:
  std::unique_ptr<Impl> impl_;
};

}  // namespace b3dgs::cuda
