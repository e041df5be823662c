// Blending a rendered view again with another kernel, and counting the load, on the GPU.
#include <gtest/gtest.h>

#include "support/approx.h"
#include "support/raster/cuda_harness.h"

namespace b3dgs::test {
namespace {

TEST(ReblendCuda, IsTheForwardOfThatKernel) {
  B3DGS_NEEDS_GPU();
  const TestScene scene = saturated_pixels();
  const std::int64_t h = scene.view.height, w = scene.view.width;
  RenderSettings settings = settings_of(scene);
  CudaView again(scene, settings);
  for (const ForwardKernelName& kernel : kForwardKernels) {
    SCOPED_TRACE(kernel.name);
    settings.kernel = kernel.kernel;
    const CudaView direct(scene, settings);
    again.rasterizer().reblend(kernel.kernel);
    torch::Tensor color = torch::empty({h, w, 3}), alpha = torch::empty({h, w});
    B3DGS_CUDA_CHECK(cudaMemcpy(color.data_ptr<float>(), again.image().color, color.nbytes(), cudaMemcpyDeviceToHost));
    B3DGS_CUDA_CHECK(cudaMemcpy(alpha.data_ptr<float>(), again.image().alpha, alpha.nbytes(), cudaMemcpyDeviceToHost));
    EXPECT_TRUE(test::same(color, direct.color));
    EXPECT_TRUE(test::same(alpha, direct.alpha));
  }
}

TEST(ReblendCuda, BackwardKernelsSumTheSame) {
  B3DGS_NEEDS_GPU();
  const TestScene scene = anisotropic_cloud();
  CudaView view(scene, settings_of(scene));
  const torch::Tensor nothing = torch::zeros({scene.view.height, scene.view.width}, torch::kBool);
  const RenderedViewGrad uneven = uneven_grad(scene.view, nothing);
  const DeviceArray<float> grad = to_device(uneven.color), grad_depth = to_device(uneven.depth);
  std::vector<torch::Tensor> sums;
  for (const BackwardKernelName& kernel : kBackwardKernels) {
    view.rasterizer().reblend_backward(kernel.kernel, {grad.data(), grad_depth.data(), nullptr});
    torch::Tensor host = torch::empty({view.rasterizer().n_rows(), 12});
    B3DGS_CUDA_CHECK(
        cudaMemcpy(host.data_ptr<float>(), view.rasterizer().splat_grads(), host.nbytes(), cudaMemcpyDeviceToHost));
    sums.push_back(host.narrow(1, 0, 10));
  }
  const torch::Tensor norm = sums[0].square().sum(0).sqrt(), off = (sums[1] - sums[0]).square().sum(0).sqrt();
  EXPECT_GT(norm.min().item<double>(), 0);
  EXPECT_LE((off / norm).max().item<double>(), 1e-3);
}

TEST(CountLoadCuda, CountsAsTheCpuDoes) {
  B3DGS_NEEDS_GPU();
  for (const TestSceneRow& row : test_scenes()) {
    SCOPED_TRACE(row.name);
    const TestScene scene = row.build();
    const std::int64_t n_pixels = std::int64_t{scene.view.height} * scene.view.width;
    const CpuView expected(scene, settings_of(scene));
    std::vector<std::int32_t> processed(static_cast<std::size_t>(n_pixels)), contributing = processed;
    expected.rasterizer().count_load(processed.data(), contributing.data());

    CudaView view(scene, settings_of(scene));
    const DeviceArray<std::int32_t> counts[2]{DeviceArray<std::int32_t>(n_pixels), DeviceArray<std::int32_t>(n_pixels)};
    view.rasterizer().count_load(counts[0].data(), counts[1].data());
    std::vector<std::int32_t> found[2]{std::vector<std::int32_t>(processed.size(), -1), contributing};
    for (int i = 0; i < 2; ++i) counts[i].download(found[i].data());
    // Rounding may change a decision at a threshold, which changes a count by one or finishes a pixel elsewhere.
    std::int64_t n_other = 0;
    for (std::size_t pixel = 0; pixel < processed.size(); ++pixel) {
      n_other += found[0][pixel] != processed[pixel] || found[1][pixel] != contributing[pixel];
    }
    EXPECT_LE(n_other, 2 + n_pixels / 100);
  }
}

}  // namespace
}  // namespace b3dgs::test
