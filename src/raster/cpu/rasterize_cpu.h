// The whole rasterizer on the CPU, without torch.
#pragma once

#include <memory>

#include "raster/args.h"
#include "raster/splat_records.h"
#include "raster/splat_rows.h"

namespace b3dgs::cpu {

/// Largest tile side that the CPU kernels support, px.
inline constexpr int kMaxTileSide = 32;

class Rasterizer {
 public:
  Rasterizer();
  ~Rasterizer();
  Rasterizer(Rasterizer&&) noexcept;
  Rasterizer& operator=(Rasterizer&&) noexcept;

  /// Renders one view into `out` and keeps what backward() needs. Uses thread_count() threads (core/parallel.h);
  /// results do not depend on their number. @throws InvalidGaussianError naming the first invalid Gaussian
  void forward(const GaussianArrays& gaussians, const PinholeView& view, const RenderSettings& settings,
               const ImageArrays& out);

  /// Gradients of the last forward(). `gaussians` and the images that forward() wrote must be unchanged.
  void backward(const GaussianArrays& gaussians, const ImageGradArrays& grad, const GaussianGradArrays& out);

  /// backward() up to the splats: keeps their sums for a later backward projection.
  void backward_to_splats(const GaussianArrays& gaussians, const ImageGradArrays& grad, const SplatRecordArrays& out);

  /// The first pass of forward() alone: writes the splats of the Gaussians that the view sees, in the order of the
  /// Gaussians, to the memory that `allocate` returns. There is no last forward() after it.
  /// @throws InvalidGaussianError naming the first invalid Gaussian
  void project(const GaussianArrays& gaussians, const PinholeView& view, const RenderSettings& settings,
               const SplatAllocator& allocate);

  /// The other passes of forward(), with the same view, culling and tiles as in project(). Splat::gaussian is ignored.
  /// A forward() for the functions below, except for those that need Gaussians: backward(), backward_to_splats(),
  /// camera_gradient() and score(). @throws LogicError if settings.camera_gradient
  void forward_splats(const SplatRows& rows, const PinholeView& view, const RenderSettings& settings,
                      const ImageArrays& out);

  /// The backward blend of the last forward_splats(): sums of each row, [M] out.
  void backward_splats(const ImageGradArrays& grad, SplatGradSum* out);

  /// score() of the last forward_splats(): sums of each row, [M] out; padding is 0.
  void score_splats(const float* error, ScoreSums* out);

  /// Blends the splats of the last forward() again with another kernel, into the same images.
  void reblend(ForwardKernel kernel);

  /// Counts the load of the last forward() into two arrays, [H, W] each (CountLoadArgs).
  void count_load(std::int32_t* processed, std::int32_t* contributing) const;

  /// [kCameraGradients] gradient with respect to the camera's pose (math/camera_grad.h), of the last backward(), after
  /// a forward() with camera_gradient.
  const double* camera_gradient() const;

  /// Adds what the pixels of the last forward() say about its Gaussians, given an error [H, W] (ScoreArgs). Overwrites
  /// memory of backward(), so that it allocates nothing after one.
  void score(const float* error, const ScoreArrays& out);

  /// [N] radii of the last forward(): 3 standard deviations in px, rounded up; 0 if the Gaussian is not seen.
  const std::int32_t* radii() const;

  /// Intermediate results of the last forward(), for statistics and tests.
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
