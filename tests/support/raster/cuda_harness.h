// For tests: the CUDA rasterizer on tensors in host memory; the counterpart of cpu_harness.h.
#pragma once

#include "raster/cuda/passes.h"
#include "support/gpu_test.h"
#include "support/raster/cpu_harness.h"

namespace b3dgs::test {

inline DeviceArray<float> to_device(const torch::Tensor& tensor) {
  return DeviceArray<float>(tensor.data_ptr<float>(), tensor.numel());
}

inline torch::Tensor to_host(const DeviceArray<float>& array, torch::IntArrayRef sizes) {
  torch::Tensor host = torch::empty(sizes, torch::kFloat32);
  array.download(host.data_ptr<float>());
  return host;
}

/// Memory from the CUDA driver.
class DriverMemory final : public cuda::DeviceMemory {
 public:
  void* allocate(std::size_t bytes, cudaStream_t stream) override {
    void* memory = nullptr;
    B3DGS_CUDA_CHECK(cudaMallocAsync(&memory, bytes, stream));
    return memory;
  }
  void free(void* memory, cudaStream_t stream) noexcept override { cudaFreeAsync(memory, stream); }
};

/// One view of a scene in the CUDA rasterizer, with the interface of CpuView.
class CudaView {
 public:
  CudaView(const TestScene& scene, const RenderSettings& settings)
      : scene_(scene),
        context_(cuda::make_launch_context(nullptr, memory_)),
        rasterizer_(cuda::make_rasterizer([context = context_] { return context; })),
        pixels_(std::int64_t{scene.view.width} * scene.view.height),
        color_(3 * pixels_),
        depth_(pixels_),
        alpha_(pixels_) {
    for (const torch::Tensor* group : scene.gaussians.all()) parameters_.push_back(to_device(*group));
    if (scene.gaussians.filters.defined()) parameters_.push_back(to_device(scene.gaussians.filters));
    rasterizer_->forward(arrays(), scene.view, settings, {color_.data(), depth_.data(), alpha_.data()});
    const std::int64_t h = scene.view.height, w = scene.view.width;
    color = to_host(color_, {h, w, 3});
    depth = to_host(depth_, {h, w});
    alpha = to_host(alpha_, {h, w});
  }

  DenseGradients backward(const RenderedViewGrad& grad) {
    std::vector<DeviceArray<float>> inputs;
    const auto pointer = [&](const torch::Tensor& tensor) -> const float* {
      if (!tensor.defined()) return nullptr;
      inputs.push_back(to_device(tensor));
      return inputs.back().data();
    };
    const ImageGradArrays image{pointer(grad.color), pointer(grad.depth), pointer(grad.alpha)};
    DenseGradients out;
    out.parameters = scene_.gaussians;
    std::vector<DeviceArray<float>> groups;
    for (const torch::Tensor* group : out.parameters.all()) groups.emplace_back(group->numel());
    const std::int64_t n = scene_.gaussians.size();
    const DeviceArray<float> means2d(2 * n);
    rasterizer_->backward(arrays(), image,
                          {groups[0].data(), groups[1].data(), groups[2].data(), groups[3].data(), groups[4].data(),
                           groups[5].data(), means2d.data()});
    for (std::size_t i = 0; i < groups.size(); ++i) {
      *out.parameters.all()[i] = to_host(groups[i], scene_.gaussians.all()[i]->sizes());
    }
    out.means2d = to_host(means2d, {n, 2});
    return out;
  }

  /// Of the last backward(), [6] double.
  torch::Tensor camera_gradient() const {
    const std::vector<double> values = download(rasterizer_->camera_gradient(), kCameraGradients);
    return torch::tensor(values, torch::kFloat64);
  }

  /// Adds to `scores`, four tensors [N] in host memory.
  void score(const torch::Tensor& error, const GaussianScores& scores) {
    const DeviceArray<float> image = to_device(error),
                             sums[4]{to_device(scores.error_sum), to_device(scores.weight_sum),
                                     to_device(scores.max_weight), to_device(scores.n_views)};
    rasterizer_->score(image.data(), {sums[0].data(), sums[1].data(), sums[2].data(), sums[3].data()});
    const torch::Tensor* const out[4]{&scores.error_sum, &scores.weight_sum, &scores.max_weight, &scores.n_views};
    for (int i = 0; i < 4; ++i) sums[i].download(out[i]->data_ptr<float>());
  }

  /// [N] int64
  torch::Tensor radii() const {
    const std::vector<std::int32_t> host = download(rasterizer_->radii(), scene_.gaussians.size());
    torch::Tensor copy = torch::zeros({scene_.gaussians.size()}, torch::kInt64);
    for (std::size_t i = 0; i < host.size(); ++i) copy[static_cast<std::int64_t>(i)] = std::int64_t{host[i]};
    return copy;
  }

  /// [H, W] int64, index of the last Gaussian blended, -1 if none.
  torch::Tensor last_gaussians() const {
    const TileGrid grid = rasterizer_->grid();
    const BinnedSplats bins = rasterizer_->bins();
    const std::vector<std::int32_t> last_ids = download(rasterizer_->last_ids(), pixels_);
    const std::vector<std::int64_t> offsets = download(bins.tile_offsets, grid.n_tiles() + 1);
    const std::vector<std::int32_t> ids = download(bins.splat_ids, bins.n_pairs);
    torch::Tensor last = torch::full({grid.image_height, grid.image_width}, -1, torch::kInt64);
    auto places = last.accessor<std::int64_t, 2>();
    for (std::int32_t y = 0; y < grid.image_height; ++y) {
      for (std::int32_t x = 0; x < grid.image_width; ++x) {
        const std::int32_t id = last_ids[static_cast<std::size_t>(y * grid.image_width + x)];
        if (id < 0) continue;
        const auto tile = static_cast<std::size_t>(y / grid.tile.height * grid.columns + x / grid.tile.width);
        const std::int32_t row = ids.at(static_cast<std::size_t>(offsets[tile] + id));
        places[y][x] = row % scene_.gaussians.size();  // second splats of a panorama follow those of all Gaussians
      }
    }
    return last;
  }

  /// For further passes on the rendered view.
  RasterizerBackend& rasterizer() { return *rasterizer_; }
  ImageArrays image() const { return {color_.data(), depth_.data(), alpha_.data()}; }

 private:
  template <class T>
  static std::vector<T> download(const T* device, std::int64_t n) {
    std::vector<T> host(static_cast<std::size_t>(n));
    B3DGS_CUDA_CHECK(cudaMemcpy(host.data(), device, host.size() * sizeof(T), cudaMemcpyDeviceToHost));
    return host;
  }

  GaussianArrays arrays() const {
    GaussianArrays host = arrays_of(scene_);
    return {host.n_gaussians,
            host.sh_degree_max,
            parameters_[0].data(),
            parameters_[1].data(),
            parameters_[2].data(),
            parameters_[3].data(),
            parameters_[4].data(),
            parameters_[5].data(),
            scene_.gaussians.filters.defined() ? parameters_[6].data() : nullptr};
  }

  const TestScene& scene_;
  DriverMemory memory_;
  cuda::LaunchContext context_;
  std::unique_ptr<RasterizerBackend> rasterizer_;
  std::int64_t pixels_;
  DeviceArray<float> color_, depth_, alpha_;
  std::vector<DeviceArray<float>> parameters_;

 public:
  torch::Tensor color, depth, alpha;  // float, on the host
};

}  // namespace b3dgs::test
