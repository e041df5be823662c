#include "app/bench/cuda/bench_cuda_frame.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "raster/math/tiling.h"

namespace b3dgs::cuda {

EventTimer::EventTimer(const LaunchContext& context) : context_(context) {
  B3DGS_CUDA_CHECK(cudaEventCreate(&start_));
  B3DGS_CUDA_CHECK(cudaEventCreate(&stop_));
  flush_.resize(kFlushBytes, context);
}

EventTimer::~EventTimer() {
  cudaEventDestroy(start_);
  cudaEventDestroy(stop_);
}

Timing EventTimer::time(int repeat, const std::function<void()>& prepare, const std::function<void()>& body) {
  std::vector<double> ms;
  for (int i = -2; i < repeat; ++i) {
    prepare();
    B3DGS_CUDA_CHECK(cudaMemsetAsync(flush_.data(), i & 1, kFlushBytes, context_.stream));
    B3DGS_CUDA_CHECK(cudaEventRecord(start_, context_.stream));
    body();
    B3DGS_CUDA_CHECK(cudaEventRecord(stop_, context_.stream));
    B3DGS_CUDA_CHECK(cudaEventSynchronize(stop_));
    float elapsed = 0;
    B3DGS_CUDA_CHECK(cudaEventElapsedTime(&elapsed, start_, stop_));
    if (i >= 0) ms.push_back(elapsed);
  }
  return summarize(std::move(ms));
}

CudaFrame::CudaFrame(const BenchRun& run, const BenchScene& scene, const LaunchContext& context)
    : context_(context),
      n_(scene.cloud.size()),
      n_pixels_(std::int64_t{scene.view.width} * scene.view.height),
      n_rest_(static_cast<std::int64_t>(scene.cloud.shN.size())) {
  const Culling culling = run.culling == "square" ? Culling::kSquare : Culling::kEllipse;
  const TileGrid grid = make_tile_grid(scene.view.width, scene.view.height, {run.tile_width, run.tile_height});
  const ProjectOutputs projected{splats_.resize(n_, context), extents_.resize(n_, context), radii_.resize(n_, context),
                                 list_growth_.resize(kCounterStride * (grid.n_tiles() + 1), context),
                                 counts_.resize(2, context)};
  const int degree = scene.cloud.sh_degree;
  project_args = {upload_gaussians(scene.cloud), scene.view, degree, kNearPlane, culling, grid, projected};
  project(project_args, context);
  number_lists(projected, grid.n_tiles(), bin_buffers, context);
  found = download(projected.counts, 1).front();
  bin_args = {projected, n_, found, grid, culling};
  binned = bin(bin_args, bin_buffers, bin_scratch, context);
  set_up_blending(grid);

  const GaussianGradArrays gradients{grad_means_.resize(3 * n_, context),  grad_log_scales_.resize(3 * n_, context),
                                     grad_quats_.resize(4 * n_, context),  grad_opacities_.resize(n_, context),
                                     grad_sh0_.resize(3 * n_, context),    grad_shN_.resize(n_rest_ + 1, context),
                                     grad_means2d_.resize(2 * n_, context)};
  project_backward_args = {project_args.gaussians,    scene.view, degree, projected.radii, projected.splats,
                           backward_args.splat_grads, gradients};
}

GaussianArrays CudaFrame::upload_gaussians(const SplatCloud& cloud) {
  return {n_,
          cloud.sh_degree,
          upload(means_, cloud.means),
          upload(log_scales_, cloud.log_scales),
          upload(quats_, cloud.quats),
          upload(opacities_, cloud.logit_opacities),
          upload(sh0_, cloud.sh0),
          upload(shN_, cloud.shN)};
}

void CudaFrame::set_up_blending(const TileGrid& grid) {
  n_parts_ = binned.buckets.n * (std::int64_t{grid.tile.width} * grid.tile.height);
  const ImageArrays image{color_.resize(3 * n_pixels_, context_), depth_.resize(n_pixels_, context_),
                          alpha_.resize(n_pixels_, context_)};
  const BucketParts parts{part_light_.resize(n_parts_, context_), nullptr};
  const Vec3f black{0, 0, 0};
  forward_args = {{splats_.data(), extents_.data(), binned.bins, grid, black, image,
                   transmittance_.resize(n_pixels_, context_), last_ids_.resize(n_pixels_, context_)},
                  binned.buckets,
                  binned.tiles_by_length,
                  cuts_lists(found, context_.n_multiprocessors),
                  parts};
  for (const ForwardKernelName& kernel : kForwardKernels) {
    scratch_.allocate(kernel.kernel, forward_args, kernel_scratch_[static_cast<std::size_t>(kernel.kernel)], context_);
  }
  const std::vector<float> mean(static_cast<std::size_t>(3 * n_pixels_), 1.0f / static_cast<float>(3 * n_pixels_));
  const ImageGradArrays grad{upload(grad_color_, mean), nullptr, nullptr};
  backward_args = {{splats_.data(), extents_.data(), binned.bins, grid, black, image, transmittance_.data(),
                    last_ids_.data(), grad, nullptr},
                   binned.buckets,
                   parts,
                   splat_grads_.resize(n_, context_)};
}

void CudaFrame::poison_outputs() {
  const auto poison = [&](void* memory, std::int64_t bytes) {
    B3DGS_CUDA_CHECK(cudaMemsetAsync(memory, 0xff, static_cast<std::size_t>(bytes), context_.stream));
  };
  constexpr std::int64_t kFloat = sizeof(float);
  poison(color_.data(), 3 * n_pixels_ * kFloat);
  for (const DeviceBuffer<float>* plane : {&depth_, &alpha_, &transmittance_})
    poison(plane->data(), n_pixels_ * kFloat);
  poison(last_ids_.data(), n_pixels_ * static_cast<std::int64_t>(sizeof(std::int32_t)));
  poison(part_light_.data(), n_parts_ * static_cast<std::int64_t>(sizeof(float4)));
}

void CudaFrame::reset_pool() {
  B3DGS_CUDA_CHECK(cudaMemsetAsync(forward_args.next_task, 0, sizeof(std::int32_t), context_.stream));
}

void CudaFrame::clear_splat_grads() {
  B3DGS_CUDA_CHECK(
      cudaMemsetAsync(splat_grads_.data(), 0, static_cast<std::size_t>(n_) * sizeof(SplatGradSum), context_.stream));
}

std::vector<float> CudaFrame::image() const {
  return download(color_.data(), 3 * n_pixels_);
}

std::vector<NamedArray> CudaFrame::gradients() const {
  std::vector<float> log_scales = download(grad_log_scales_.data(), 3 * n_);
  // For nearly spherical Gaussians, gradients of the rotation are only rounding errors, of about the size of those in
  // the gradients of the scales. Differences are therefore taken relative to the latter.
  double by_scale = 0;
  for (const float value : log_scales) by_scale = std::max(by_scale, std::fabs(double{value}));
  return {{"means", download(grad_means_.data(), 3 * n_)},
          {"log_scales", std::move(log_scales)},
          {"quats", download(grad_quats_.data(), 4 * n_), by_scale},
          {"logit_opacities", download(grad_opacities_.data(), n_)},
          {"sh0", download(grad_sh0_.data(), 3 * n_)},
          {"shN", download(grad_shN_.data(), n_rest_)}};
}

nlohmann::ordered_json CudaFrame::lists() const {
  const std::int32_t n_tiles = forward_args.blend.grid.n_tiles();
  const std::vector<std::int64_t> offsets = download(binned.bins.tile_offsets, n_tiles + 1);
  std::vector<std::int64_t> lengths;
  for (std::size_t tile = 0; tile + 1 < offsets.size(); ++tile) lengths.push_back(offsets[tile + 1] - offsets[tile]);
  return list_statistics(lengths);
}

const float* CudaFrame::upload(DeviceBuffer<float>& buffer, const std::vector<float>& host) {
  float* const device = buffer.resize(static_cast<std::int64_t>(host.size()) + 1, context_);  // never empty
  B3DGS_CUDA_CHECK(
      cudaMemcpyAsync(device, host.data(), host.size() * sizeof(float), cudaMemcpyHostToDevice, context_.stream));
  return device;
}

template <class T>
std::vector<T> CudaFrame::download(const T* device, std::int64_t count) const {
  std::vector<T> host(static_cast<std::size_t>(count));
  B3DGS_CUDA_CHECK(
      cudaMemcpyAsync(host.data(), device, host.size() * sizeof(T), cudaMemcpyDeviceToHost, context_.stream));
  B3DGS_CUDA_CHECK(cudaStreamSynchronize(context_.stream));
  return host;
}

}  // namespace b3dgs::cuda
