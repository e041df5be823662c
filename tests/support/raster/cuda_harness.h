// Test support: the CUDA rasterizer on tensors in host memory, the counterpart of cpu_harness.h.
#pragma once

#include "raster/cuda/passes.h"
#include "support/gpu_test.h"
#include "support/raster/cpu_harness.h"

namespace b3dgs::test {

/// A test of each scene of test_scenes().
class GpuSceneTest : public testing::TestWithParam<TestSceneRow> {
 protected:
  void SetUp() override { B3DGS_NEEDS_GPU(); }
};
inline std::string name_of_scene(const testing::TestParamInfo<TestSceneRow>& info) {
  return info.param.name;
}

/// A tensor in device memory, because this LibTorch may have no CUDA.
class DeviceTensor {
 public:
  /// Copies a tensor, which may be undefined.
  explicit DeviceTensor(const torch::Tensor& host)
      : host_(host.defined() ? host.contiguous() : torch::Tensor()), bytes_(host_.defined() ? host_.nbytes() : 0) {
    if (host_.defined()) {
      B3DGS_CUDA_CHECK(cudaMemcpy(bytes_.data(), host_.data_ptr(), host_.nbytes(), cudaMemcpyHostToDevice));
    }
  }
  /// Makes a tensor filled with 0xff bytes.
  explicit DeviceTensor(torch::IntArrayRef sizes, torch::ScalarType type = torch::kFloat32)
      : host_(torch::empty(sizes, type)), bytes_(host_.nbytes()) {}

  /// Returns null if the tensor is undefined.
  template <class T = float>
  T* data() const {
    return host_.defined() ? reinterpret_cast<T*>(bytes_.data()) : nullptr;
  }
  torch::Tensor to_host() const {
    torch::Tensor copy = torch::empty_like(host_);
    bytes_.download(static_cast<std::uint8_t*>(copy.data_ptr()));
    return copy;
  }

 private:
  torch::Tensor host_;
  DeviceArray<std::uint8_t> bytes_;
};

template <class T>
std::vector<T> download(const T* device, std::int64_t n) {
  std::vector<T> host(static_cast<std::size_t>(n));
  B3DGS_CUDA_CHECK(cudaMemcpy(host.data(), device, host.size() * sizeof(T), cudaMemcpyDeviceToHost));
  return host;
}

/// Gaussians in device memory.
class DeviceGaussians {
 public:
  explicit DeviceGaussians(const GaussianTensors& gaussians) {
    TestScene scene;
    scene.gaussians = gaussians;
    arrays_ = arrays_of(scene);
    for (const torch::Tensor* group : gaussians.all()) groups_.emplace_back(*group);
    groups_.emplace_back(gaussians.filters);
  }
  GaussianArrays arrays() const {
    return {arrays_.n_gaussians, arrays_.sh_degree_max, groups_[0].data(), groups_[1].data(), groups_[2].data(),
            groups_[3].data(),   groups_[4].data(),     groups_[5].data(), groups_[6].data()};
  }

 private:
  std::vector<DeviceTensor> groups_;
  GaussianArrays arrays_;
};

/// A rendered view, or its gradients, in device memory.
struct DeviceImages {
  explicit DeviceImages(const CameraView& view)
      : color({view.height, view.width, 3}), depth({view.height, view.width}), alpha({view.height, view.width}) {}
  explicit DeviceImages(const RenderedView& host) : color(host.color), depth(host.depth), alpha(host.alpha) {}
  explicit DeviceImages(const RenderedViewGrad& host) : color(host.color), depth(host.depth), alpha(host.alpha) {}
  ImageArrays arrays() const { return {color.data(), depth.data(), alpha.data()}; }
  ImageGradArrays grad() const { return {color.data(), depth.data(), alpha.data()}; }
  RenderedView to_host() const { return {color.to_host(), depth.to_host(), alpha.to_host()}; }
  DeviceTensor color, depth, alpha;
};

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
      : scene_(scene), gaussians_(scene.gaussians), images_(scene.view) {
    rasterizer_->forward(gaussians_.arrays(), scene.view, settings, images_.arrays());
    const RenderedView host = images_.to_host();
    color = host.color, depth = host.depth, alpha = host.alpha;
  }

  DenseGradients backward(const RenderedViewGrad& grad) {
    DenseGradients out;
    out.parameters = scene_.gaussians;
    std::vector<DeviceTensor> groups;
    for (const torch::Tensor* group : out.parameters.all()) groups.emplace_back(group->sizes());
    const DeviceTensor means2d({scene_.gaussians.size(), 2});
    rasterizer_->backward(gaussians_.arrays(), DeviceImages(grad).grad(),
                          {groups[0].data(), groups[1].data(), groups[2].data(), groups[3].data(), groups[4].data(),
                           groups[5].data(), means2d.data()});
    for (std::size_t i = 0; i < groups.size(); ++i) *out.parameters.all()[i] = groups[i].to_host();
    out.means2d = means2d.to_host();
    return out;
  }

  /// Returns the camera gradient of the last backward(), [6] double.
  torch::Tensor camera_gradient() const {
    const std::vector<double> values = download(rasterizer_->camera_gradient(), kCameraGradients);
    return torch::tensor(values, torch::kFloat64);
  }

  /// Adds to `scores`, four tensors [N] in host memory.
  void score(const torch::Tensor& error, const GaussianScores& scores) {
    const torch::Tensor* const out[4]{&scores.error_sum, &scores.weight_sum, &scores.max_weight, &scores.n_views};
    std::vector<DeviceTensor> sums;
    for (const torch::Tensor* tensor : out) sums.emplace_back(*tensor);
    rasterizer_->score(DeviceTensor(error).data(), {sums[0].data(), sums[1].data(), sums[2].data(), sums[3].data()});
    for (int i = 0; i < 4; ++i) out[i]->copy_(sums[static_cast<std::size_t>(i)].to_host());
  }

  /// Returns tensors in host memory.
  SurfaceView geometry(DepthKind kind) {
    const std::int64_t h = scene_.view.height, w = scene_.view.width;
    const DeviceTensor depth({h, w}), normal({h, w, 3}), confidence({h, w});
    rasterizer_->geometry(gaussians_.arrays(), kind, {depth.data(), normal.data(), confidence.data()});
    return {depth.to_host(), normal.to_host(), confidence.to_host()};
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
    const std::vector<std::int32_t> last_ids = download(rasterizer_->last_ids(), alpha.numel());
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
        places[y][x] = row % scene_.gaussians.size();  // the second splats of a panorama follow those of all Gaussians
      }
    }
    return last;
  }

  /// Gives access to further passes on the rendered view.
  RasterizerBackend& rasterizer() { return *rasterizer_; }
  RenderedView image() const { return images_.to_host(); }

 private:
  const TestScene& scene_;
  DriverMemory memory_;
  cuda::LaunchContext context_ = cuda::make_launch_context(nullptr, memory_);
  std::unique_ptr<RasterizerBackend> rasterizer_ = cuda::make_rasterizer([context = context_] { return context; });
  DeviceGaussians gaussians_;
  DeviceImages images_;

 public:
  torch::Tensor color, depth, alpha;  // float, on the host
};

}  // namespace b3dgs::test
