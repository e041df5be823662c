// The whole rasterizer on the CPU, without torch.
#pragma once

#include <memory>

#include "raster/args.h"

namespace b3dgs::cpu {

/// Side of the largest tile that the CPU kernels accept, px.
inline constexpr int kMaxTileSide = 32;

class Rasterizer {
 public:
  Rasterizer();
  ~Rasterizer();
  Rasterizer(Rasterizer&&) noexcept;
  Rasterizer& operator=(Rasterizer&&) noexcept;

  /// Renders one view into `out` and keeps what backward() needs. Uses thread_count() threads (parallel.h); the result
  /// does not depend on how many.
  /// @throws NumericError naming the Gaussian if a projection is not finite.
  void forward(const GaussianArrays& gaussians, const PinholeView& view, const RenderSettings& settings,
               const ImageArrays& out);

  /// Gradients of the last forward(). `gaussians` and the arrays it rendered into must be unchanged since.
  void backward(const GaussianArrays& gaussians, const ImageGradArrays& grad, const GaussianGradArrays& out);

  /// Blends the splats of the last forward() again with another kernel, into the same arrays.
  void reblend(ForwardKernel kernel);

  /// Of the last forward(), into [H, W] each (CountLoadArgs).
  void count_load(std::int32_t* processed, std::int32_t* contributing) const;

  /// [N] of the last forward(): 3 standard deviations in px, rounded up; 0 if the Gaussian was not seen.
  const std::int32_t* radii() const;

  /// Of the last forward(), for statistics and tests.
  const std::int32_t* last_ids() const;  // [H, W]
  const Splat* splats() const;           // [M]
  BinnedSplats bins() const;
  TileGrid grid() const;
  std::int64_t n_splats() const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace b3dgs::cpu
