// Order of the passes on the GPU, and the memory between them.

#include "raster/cuda/rasterize_cuda.h"

#include <limits>

#include "raster/cuda/backward_table.h"
#include "raster/cuda/forward_table.h"
#include "raster/cuda/passes.h"
#include "raster/tiling.h"

namespace b3dgs::cuda {
namespace {

/// A host value that the device can write to directly.
template <class T>
class PinnedValue {
 public:
  PinnedValue() { B3DGS_CUDA_CHECK(cudaMallocHost(reinterpret_cast<void**>(&value_), sizeof(T))); }
  ~PinnedValue() { cudaFreeHost(value_); }
  PinnedValue(const PinnedValue&) = delete;
  PinnedValue& operator=(const PinnedValue&) = delete;
  T* get() const { return value_; }

 private:
  T* value_ = nullptr;
};

}  // namespace

struct Rasterizer::Impl {
  DeviceBuffer<Splat> splats;
  DeviceBuffer<Vec2f> extents;
  DeviceBuffer<std::int32_t> radii, n_tiles, last_ids, next_task;
  DeviceBuffer<ViewCounts> counts;
  DeviceBuffer<float4> state_light;
  DeviceBuffer<float> state_depth, transmittance;
  DeviceBuffer<SplatGradSum> splat_grads;
  BinBuffers bin_buffers;
  PinnedValue<ViewCounts> host_counts;

  // Of the last forward pass.
  PinholeView view{};
  int sh_degree = 0;
  BackwardKernel backward_kernel{};
  TileGrid grid{};
  std::int64_t n_gaussians = -1, n_splats = 0;
  BinnedView binned{};
  BucketStates buckets{};
  Vec3f background{};
  ImageArrays rendered{};
};

Rasterizer::Rasterizer() : impl_(std::make_unique<Impl>()) {}
Rasterizer::~Rasterizer() = default;
Rasterizer::Rasterizer(Rasterizer&&) noexcept = default;
Rasterizer& Rasterizer::operator=(Rasterizer&&) noexcept = default;

void Rasterizer::forward(const GaussianArrays& gaussians, const PinholeView& view, const RenderSettings& settings,
                         const ImageArrays& out, const LaunchContext& context) {
  constexpr std::int64_t kIndexMax = std::numeric_limits<std::int32_t>::max() - 1;
  B3DGS_CHECK(view.width > 0 && view.height > 0, "image is ", view.width, " x ", view.height);
  B3DGS_CHECK(settings.sh_degree >= 0 && settings.sh_degree <= gaussians.sh_degree_max, "SH degree ",
              settings.sh_degree, " of at most ", gaussians.sh_degree_max);
  B3DGS_CHECK(gaussians.n_gaussians <= kIndexMax, "splats carry 32-bit indices; n_gaussians is ",
              gaussians.n_gaussians);
  B3DGS_CHECK(settings.near_plane > 0, "near plane is at ", settings.near_plane, "; depths are sorted as positive");
  Impl& s = *impl_;
  const std::int64_t n = gaussians.n_gaussians;
  s.n_gaussians = -1;  // until this pass has succeeded
  s.view = view;
  s.sh_degree = settings.sh_degree;
  s.grid = make_tile_grid(view.width, view.height, settings.tile);
  s.background = settings.background;
  s.rendered = out;

  const ProjectOutputs projected{s.splats.resize(n, context), s.extents.resize(n, context), s.radii.resize(n, context),
                                 s.n_tiles.resize(n, context), s.counts.resize(1, context)};
  project({gaussians, view, settings.sh_degree, settings.near_plane, settings.culling, s.grid, projected}, context);
  B3DGS_CUDA_CHECK(cudaMemcpyAsync(s.host_counts.get(), projected.counts, sizeof(ViewCounts), cudaMemcpyDeviceToHost,
                                   context.stream));
  B3DGS_CUDA_CHECK(cudaStreamSynchronize(context.stream));
  const ViewCounts counts = *s.host_counts.get();
  if (counts.not_finite < n) {
    throw NumericError(detail::concat("Gaussian ", counts.not_finite, " has no finite projection"));
  }
  if (counts.n_isects > kIndexMax) {
    throw NumericError(detail::concat("the view needs ", counts.n_isects, " (tile, Gaussian) pairs, more than ",
                                      kIndexMax, "; Gaussians have grown over the whole image, or there are too many"));
  }
  s.n_splats = counts.n_splats;
  s.binned = bin({projected, n, counts.n_splats, counts.n_isects, s.grid, settings.culling}, s.bin_buffers, context);

  s.buckets = {};
  s.backward_kernel = settings.backward_kernel;
  if (settings.keep_for_backward) {
    const std::int64_t n_states = s.binned.n_buckets_max * (std::int64_t{settings.tile.width} * settings.tile.height);
    s.buckets = {s.binned.bucket_offsets, s.state_light.resize(n_states, context),
                 s.state_depth.resize(n_states, context)};
  }
  const std::int64_t n_pixels = std::int64_t{view.width} * view.height;
  std::int32_t* const next_task = s.next_task.resize(1, context);
  B3DGS_CUDA_CHECK(cudaMemsetAsync(next_task, 0, sizeof(std::int32_t), context.stream));
  const BlendForwardArgs blend{s.binned.splats,
                               s.binned.extents,
                               s.binned.bins,
                               s.grid,
                               settings.background,
                               out,
                               s.transmittance.resize(n_pixels, context),
                               s.last_ids.resize(n_pixels, context)};
  kForwardTable[static_cast<std::size_t>(settings.kernel)].launch({blend, s.buckets, next_task}, context);
  s.n_gaussians = n;
}

void Rasterizer::backward(const GaussianArrays& gaussians, const ImageGradArrays& grad, const GaussianGradArrays& out,
                          const LaunchContext& context) {
  Impl& s = *impl_;
  B3DGS_CHECK(s.n_gaussians == gaussians.n_gaussians, "backward of ", gaussians.n_gaussians,
              " Gaussians after a forward of ", s.n_gaussians);
  B3DGS_CHECK(s.buckets.offsets != nullptr, "backward after a forward that kept nothing for it");
  SplatGradSum* const splat_grads = s.splat_grads.resize(s.n_splats, context);
  B3DGS_CUDA_CHECK(
      cudaMemsetAsync(splat_grads, 0, static_cast<std::size_t>(s.n_splats) * sizeof(SplatGradSum), context.stream));
  const BlendBackwardArgs blend{s.binned.splats, s.binned.extents,       s.binned.bins,     s.grid, s.background,
                                s.rendered,      s.transmittance.data(), s.last_ids.data(), grad,   nullptr};
  kBackwardTable[static_cast<std::size_t>(s.backward_kernel)].launch(
      {blend, s.buckets, s.binned.tile_of_bucket, s.binned.n_buckets_max, splat_grads}, context);
  project_backward(
      {gaussians, s.view, s.sh_degree, s.radii.data(), s.binned.rank_of_gaussian, s.binned.splats, splat_grads, out},
      context);
}

const std::int32_t* Rasterizer::radii() const {
  return impl_->radii.data();
}
const std::int32_t* Rasterizer::last_ids() const {
  return impl_->last_ids.data();
}
const Splat* Rasterizer::splats() const {
  return impl_->binned.splats;
}
BinnedSplats Rasterizer::bins() const {
  return impl_->binned.bins;
}
TileGrid Rasterizer::grid() const {
  return impl_->grid;
}
std::int64_t Rasterizer::n_splats() const {
  return impl_->n_splats;
}

}  // namespace b3dgs::cuda
