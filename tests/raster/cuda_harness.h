// The CUDA rasterizer on tensors of the host: the counterpart of cpu_harness.h.
#pragma once

#include "raster/cpu_harness.h"
#include "raster/cuda/rasterize_cuda.h"
#include "support/gpu_test.h"

namespace b3dgs::test {

inline DeviceArray<float> to_device(const torch::Tensor& tensor) {
  return DeviceArray<float>(tensor.data_ptr<float>(), tensor.numel());
}

inline torch::Tensor to_host(const DeviceArray<float>& array, torch::IntArrayRef sizes) {
  torch::Tensor host = torch::empty(sizes, torch::kFloat32);
  array.download(host.data_ptr<float>());
  return host;
}

/// One view of a scene in the CUDA rasterizer, with the interface of CpuView.
class CudaView {
 public:
  CudaView(const TestScene& scene, const RenderSettings& settings)
      : scene_(scene),
        context_(cuda::make_launch_context(nullptr, memory_)),
        pixels_(std::int64_t{scene.view.width} * scene.view.height),
        color_(3 * pixels_),
        depth_(pixels_),
        alpha_(pixels_) {
    for (const torch::Tensor* group : scene.gaussians.all()) parameters_.push_back(to_device(*group));
    rasterizer_.forward(arrays(), scene.view, settings, {color_.data(), depth_.data(), alpha_.data()}, context_);
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
    rasterizer_.backward(arrays(), image,
                         {groups[0].data(), groups[1].data(), groups[2].data(), groups[3].data(), groups[4].data(),
                          groups[5].data(), means2d.data()},
                         context_);
    for (std::size_t i = 0; i < groups.size(); ++i) {
      *out.parameters.all()[i] = to_host(groups[i], scene_.gaussians.all()[i]->sizes());
    }
    out.means2d = to_host(means2d, {n, 2});
    return out;
  }

  /// [N] int64
  torch::Tensor radii() const {
    torch::Tensor host = torch::empty({scene_.gaussians.size()}, torch::kInt32);
    B3DGS_CUDA_CHECK(cudaMemcpy(host.data_ptr<std::int32_t>(), rasterizer_.radii(),
                                static_cast<std::size_t>(host.numel()) * sizeof(std::int32_t), cudaMemcpyDeviceToHost));
    return host.to(torch::kInt64);
  }

 private:
  GaussianArrays arrays() const {
    GaussianArrays host = arrays_of(scene_);
    return {host.n_gaussians,      host.sh_degree_max,    parameters_[0].data(), parameters_[1].data(),
            parameters_[2].data(), parameters_[3].data(), parameters_[4].data(), parameters_[5].data()};
  }

  const TestScene& scene_;
  cuda::DriverMemory memory_;
  cuda::LaunchContext context_;
  std::int64_t pixels_;
  DeviceArray<float> color_, depth_, alpha_;
  std::vector<DeviceArray<float>> parameters_;
  cuda::Rasterizer rasterizer_;

 public:
  torch::Tensor color, depth, alpha;  // float, on the host
};

}  // namespace b3dgs::test
